"""Trials from simulations that differ from the diagnosis' own.

Their mass points are equal, as in Eq. 1.
"""

from dataclasses import replace

import numpy as np
import pytest
from conftest import TRUTH as ORDINARY
from conftest import ordinary
from synthetic_trials import SWING, diagnose_trials, sample_curve, simulate_trial

from stringcast.stages.model.effects.tip_mass import TipMass
from stringcast.stages.model.engine.implicit_leapfrog import ImplicitLeapfrog

TRUTH = ORDINARY | {
    "bending_stiffness": 6.0,
    "axial_stiffness": 5e5,
    "grasp_stiffness": 4.0,
}


@pytest.fixture(scope="module")
def chain(arm):
    """Return the paper's string: ten equal points, with implicit steps."""
    model = ordinary(arm)
    return replace(model, string=replace(model.string, integrator=ImplicitLeapfrog()))


def diagnose_swings(arm, configured, true_model, values, seed):
    """Diagnose two swings of a string measured at every other mass point."""
    rng = np.random.default_rng(seed)
    places = np.arange(1, true_model.string.points, 2)
    trials = []
    for k in range(2):
        control = np.zeros((1, 3, 6))
        control[0, :, 1:-1] = (3 + k) * SWING
        angles = sample_curve(arm, control, 0.5)
        trial = simulate_trial(f"t{k}", arm, true_model, values, angles, places, rng)
        trials.append(trial)
    return diagnose_trials(configured, trials, 4)


def test_data_from_the_configured_mesh_show_no_cause(arm, chain):
    """The configured mesh itself is not named as a cause.

    It differs from a continuous string by ten standard deviations.
    """
    diagnosis = diagnose_swings(arm, chain, chain, TRUTH, 0)
    assert diagnosis.verdict == "none", diagnosis.sentence


@pytest.mark.long
def test_a_cause_on_the_configured_mesh_has_its_size_there(arm, chain):
    """On a fine mesh the tip mass would be too large by half a segment, 5.6 %."""
    heavy = chain.with_effects(TipMass)
    truth = TRUTH | {"tip_mass.ratio": 0.1}
    diagnosis = diagnose_swings(arm, chain, heavy, truth, 1)
    assert diagnosis.verdict == "effect"
    assert set(diagnosis.causes["effect"]) == {"tip_mass"}
    row = diagnosis.causes.set_index("parameter").loc["tip_mass.ratio"]
    assert row["low"] < 0.1 < row["high"]


@pytest.mark.long
def test_another_chain_of_points_is_found_as_a_cause(arm, chain):
    """A chain with another number of points is named as a cause.

    Its last point is too heavy by half a segment, so a tip mass is a look-alike.
    """
    other = replace(chain, string=replace(chain.string, points=30))
    diagnosis = diagnose_swings(arm, chain, other, TRUTH, 2)
    assert diagnosis.verdict in ("effect", "ambiguous"), diagnosis.sentence
    causes = set(diagnosis.causes["effect"])
    assert "equal_points" in causes <= {"equal_points", "tip_mass"}
