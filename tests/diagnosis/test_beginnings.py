"""Released strings: a wrong initial state is not mistaken for a cause."""

import numpy as np
import pytest
from conftest import TRUTH, ordinary
from synthetic_trials import diagnose_trials, make_observation

from stringcast.stages.diagnose import diagnose as module
from stringcast.stages.diagnose.search import cause_search
from stringcast.stages.diagnose.trials.discretisation import with_second_order_mesh
from stringcast.stages.model.hand import resample_joint_motion
from stringcast.stages.model.library import find_effects
from stringcast.stages.model.state import StringState

LENGTH_M = 0.3
EFFECTS = (
    "tip_mass",
    "density_taper",
    "time_offset",
    "wind",
    "rest_curvature",
    "resolution",
)


def bent_state(turn):
    """Make the state of a string at rest that is bent by `turn` [rad] up to its tip."""
    s = np.linspace(0, LENGTH_M, 41)
    angle = -np.pi / 2 + turn * s / LENGTH_M
    return StringState(0.0, s, angle, np.zeros(41))


def simulate_releases(model, wind):
    """Yield two trials of strings released in a wind to the right [m/s]."""
    windy = model.with_effects(*find_effects(["wind"])).with_segments(40)
    rng = np.random.default_rng(0)
    truth = {**TRUTH, "wind.along_x": wind, "wind.along_y": 0.0}
    values = windy.values(truth)[None]
    t = model.arm.tick * np.arange(140)
    # the grasp points down
    angles = np.zeros((len(t), 3)) + [0.6, -0.5, -np.pi / 2 - 0.1]
    motion = resample_joint_motion(t, angles)
    places = np.arange(10, 41, 10)
    for number, turn in enumerate((0.5, -0.4)):
        strings = windy.simulate_observation(motion, values, t, bent_state(turn))
        clean = strings.points[0][:, places]
        yield make_observation(
            f"t{number}", windy, t, angles, clean, places, rng, starts_moving=True
        )


@pytest.mark.parametrize(("wind", "causes"), [(0.3, {"wind"}), (0.0, set())])
def test_wrong_initial_states_are_not_explained_by_wind(arm, monkeypatch, wind, causes):
    library = {effect.name: effect for effect in find_effects(EFFECTS)}
    for each in (cause_search, module):
        monkeypatch.setattr(each, "effects_by_name", lambda: library)
    model = with_second_order_mesh(ordinary(arm))
    trials = list(simulate_releases(model, wind))
    diagnosis = diagnose_trials(model, trials, 2)
    assert set(diagnosis.causes["effect"]) == causes, diagnosis.sentence
    assert diagnosis.verdict == ("effect" if causes else "none")
    if causes:
        row = diagnosis.causes.set_index("parameter").loc["wind.along_x"]
        assert 0.5 * wind < row["low"] < wind < row["high"]
