"""The side on which a string at rest hangs from a hand that points up.

The first frames show it.
"""

import numpy as np
import pytest

from stringcast.stages.inference.batch import simulate_trials
from stringcast.stages.inference.prepared_trial import prepare_trial
from stringcast.stages.model.hand import resample_hand_motion
from stringcast.stages.model.model import Model
from tests.conftest import implicit_string
from tests.observations import grasp_table, observe_points

LENGTH, NOISE = 0.3, 1.5e-3
NAMED = {
    "bending_stiffness": 30.0,
    "bending_damping": 0.05,
    "linear_drag": 1.0,
    "grasp_stiffness": 5.0,
}
T = np.arange(0, 0.5, 1 / 120)
GRASP = np.column_stack([0.2 * np.clip(T - 0.1, 0, None) ** 2, 0 * T, 0 * T])
PLACES = {
    "line": np.linspace(0.01, LENGTH, 30),
    "dense": np.linspace(0.002, LENGTH, 75),
    "tip": np.array([LENGTH]),
}


@pytest.fixture
def model(arm, camera):
    string = implicit_string(21, 1e-3, LENGTH)
    return Model(string, arm, camera)


def observed(model, values, side, lean, places):
    """Simulate a string that hangs on the left (1) or right (-1) of a hand.

    The hand leans [rad] to the other side.
    """
    grasp = GRASP + [0, 0, np.pi / 2 - side * lean]
    points = model.simulate_string(
        resample_hand_motion(T, grasp), values, T, turn=2.0 * side
    ).points[0]
    s = model.string.arc_lengths()
    line = [[np.interp(places, s, one[:, axis]) for axis in (0, 1)] for one in points]
    seen = np.array(line).transpose(0, 2, 1)
    seen = seen + np.random.default_rng(0).normal(0, NOISE, seen.shape)
    hand = grasp_table(T, grasp)
    return observe_points("r", T, places, seen, NOISE, grasp=hand)


@pytest.mark.parametrize("where", PLACES)
@pytest.mark.parametrize("lean", [-0.1, 0.0, 0.1])
def test_a_trial_at_rest_is_on_the_side_of_its_first_frames(model, where, lean):
    """A trial may be alone or together with one on the other side."""
    values = model.values(NAMED)[None]
    trials = [
        prepare_trial(model, observed(model, values, side, lean, PLACES[where]))
        for side in (1, -1)
    ]
    assert [np.sign(trial.turn) for trial in trials] == [1, -1]
    for trial, together in zip(
        trials, simulate_trials(model, trials, values), strict=True
    ):
        _, alone = next(trial.simulate(values))
        np.testing.assert_array_equal(alone.points, together)
        off = trial.sample_at_points(together)[0] - trial.points
        assert np.sqrt(np.mean(off**2)) == pytest.approx(NOISE, rel=0.2)
