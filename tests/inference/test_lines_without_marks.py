"""Points on a line without marks: where the string is stretched is not measured."""

from dataclasses import replace

import numpy as np
import pytest

from stringcast.stages.common import rms
from stringcast.stages.extract.centreline import cumulative_length
from stringcast.stages.inference.prepared_trial import prepare_trial
from stringcast.stages.model.engine.sampling import interpolate_shares
from stringcast.stages.model.hand import resample_hand_motion
from stringcast.stages.model.interpolation import interpolate_rows
from stringcast.stages.model.library import find_effects
from stringcast.stages.model.model import Model
from tests.conftest import implicit_string
from tests.observations import grasp_table, observe_points

LENGTH = 0.3
T = np.arange(0, 0.4, 0.01)
SHARES = np.linspace(0, 1, 31)
SIGMA_M = 1e-4
UNKNOWN = np.full((len(SHARES), 2), np.nan)  # start of the line


def test_points_at_shares_of_an_arc_lie_on_it():
    """A string that is stretched unevenly lies on a circle."""

    def bend(share):
        return np.stack([np.sin(2 * share), 1 - np.cos(2 * share)], axis=-1)

    worst = []
    for count in (11, 21):
        place = np.linspace(0, 1, count)
        points = bend(place + 0.1 * place * (1 - place))
        frame = np.zeros(len(SHARES), dtype=int)
        found = interpolate_shares(points[None, None], frame, SHARES, UNKNOWN)[0]
        worst.append(np.abs(found - bend(SHARES)).max())
    assert worst[0] < 1e-3
    assert worst[1] < worst[0] / 3  # second order


@pytest.mark.parametrize("points", [3, 4])
def test_the_shortest_strings_can_be_sampled(points):
    line = np.stack([np.linspace(0, 0.3, points), np.zeros(points)], axis=-1)
    frame = np.zeros(len(SHARES), dtype=int)
    found = interpolate_shares(line[None, None], frame, SHARES, UNKNOWN)[0]
    np.testing.assert_allclose(found[:, 0], 0.3 * SHARES, atol=1e-12)


def test_a_stretched_line_is_compared_by_share(arm, camera):
    """A heavy tip stretches a soft string evenly; without it, mostly at the grasp.

    As places of marks, the shares of its length would be wrong by up to 4 mm.
    """
    string = implicit_string(41, 1e-3, LENGTH)
    model = Model(string, arm, camera).with_effects(*find_effects(["tip_mass"]))
    values = model.values({"axial_stiffness": 1e4, "tip_mass.ratio": 0.25})
    turn = np.where(T > 0.1, 8.0 * (T - 0.1), 0.0)
    pose = np.stack([0 * T, 0 * T, turn - np.pi / 2], axis=-1)
    hand = resample_hand_motion(T, pose)
    lines = model.simulate_string(hand, values[None], T).points[0]
    seen = []
    for line in lines:
        depth = cumulative_length(line)
        seen.append(interpolate_rows(SHARES * depth[-1], depth, line))
    observation = observe_points(
        "line", T, SHARES * LENGTH, np.array(seen), SIGMA_M, grasp=grasp_table(T, pose)
    )

    def misfit_m(table):
        trial = prepare_trial(model, replace(observation, points=table))
        _, motion = next(trial.simulate(values[None]))
        apart = trial.sample_at_points(motion.points)[0] - trial.points
        return rms(np.linalg.norm(apart, axis=1))

    assert misfit_m(observation.points.assign(by_share=True)) < 2e-5
    assert misfit_m(observation.points) > 1e-3


@pytest.mark.parametrize("shift_m", [-0.003, 0.0, 0.003])
def test_a_line_is_compared_from_the_hand_where_it_was_read(arm, camera, shift_m):
    """The string hangs straight down; its hand is believed to be higher or lower.

    As shares of the string, places would be wrong by up to the shift.
    """
    model = Model(implicit_string(21, 1e-3, LENGTH), arm, camera)
    pose = np.stack([0 * T, 0 * T, 0 * T - np.pi / 2], axis=-1)
    hand = resample_hand_motion(T, pose)
    values = model.values({})
    lines = model.simulate_string(hand, values[None], T).points[0]
    start = np.array([0.001, shift_m])  # [m], beside the string as well
    seen = []
    for line in lines:
        read_line = np.concatenate([start[None], line[line[:, 1] < shift_m]])
        read_line[0, 0] = 0.0
        depth = cumulative_length(read_line)
        points = interpolate_rows(SHARES * depth[-1], depth, read_line)
        points[0] = start
        seen.append(points)
    observation = observe_points(
        "line", T, SHARES * LENGTH, np.array(seen), SIGMA_M, grasp=grasp_table(T, pose)
    )
    table = observation.points.assign(by_share=True)
    trial = prepare_trial(model, replace(observation, points=table))
    apart = trial.sample_at_points(lines[None])[0] - trial.points
    is_start = trial.s == 0
    # the string stretches unevenly within its segments
    assert np.abs(apart[~is_start]).max() < 5e-5
    assert apart[is_start] == pytest.approx(np.array([[-0.001, 0]] * len(T)), abs=5e-5)
