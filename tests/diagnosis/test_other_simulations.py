"""Trials made by other simulations than the diagnosis' own: of mass points, as Eq. 1
has them.
"""

from dataclasses import replace

import numpy as np
import pytest
from conftest import TRUTH as ORDINARY
from conftest import ordinary
from performed import performed, said_of

from stringcast.stages.generate.curves import Curves
from stringcast.stages.model.effects.tip_mass import TipMass

TRUTH = ORDINARY | {
    "bending_stiffness": 6.0,
    "axial_stiffness": 5e5,
    "grasp_stiffness": 4.0,
}


@pytest.fixture(scope="module")
def eq1(arm):
    """The paper's string: ten equal points."""
    return ordinary(arm)


def measured(arm, model, values, rng, trials=2):
    """Observations of swings there and back, with points where the mass points are."""
    for k in range(trials):
        control = np.zeros((1, 3, 6))
        control[0, :, 1:-1] = (3 + k) * np.array(
            [[1.0, 0.6, -0.4, -1.0], [0.5, 0.9, 0.2, -0.8], [0.3] * 4]
        )
        angles = Curves(np.array([[0.3, 0.5, 0.2]]), np.array([0.5]), control).sample(
            arm.tick, 0.5
        )[0][0]
        yield performed(
            f"t{k}", arm, model, values, angles, np.arange(1, model.string.points), rng
        )


def test_the_configured_model_itself_is_left_alone(arm, eq1):
    """It differs from a string without mass points by ten sigmas, which is nobody's
    fault.
    """
    said = said_of(eq1, list(measured(arm, eq1, TRUTH, np.random.default_rng(0))), 4)
    assert said.verdict == "none", said.sentence


@pytest.mark.long
def test_what_is_hidden_in_such_a_chain_has_the_size_it_has_there(arm, eq1):
    """Against a string without mass points the tip would seem heavier by half a
    segment, 5.6 %.
    """
    heavy = eq1.with_effects(TipMass)
    said = said_of(
        eq1,
        list(
            measured(
                arm, heavy, TRUTH | {"tip_mass.ratio": 0.1}, np.random.default_rng(1)
            )
        ),
        4,
    )
    assert said.verdict == "effect"
    found = said.causes[said.causes["parameter"] == "tip_mass.ratio"].iloc[0]
    assert set(said.causes["effect"]) == {"tip_mass"}
    assert found["low"] < 0.1 < found["high"]


@pytest.mark.long
def test_a_chain_of_other_points_than_ours_is_one(arm, eq1):
    """Its last point stands for half a segment too much: in gentle swings that may also
    be a tip mass.
    """
    other = replace(eq1, string=replace(eq1.string, points=30))
    said = said_of(eq1, list(measured(arm, other, TRUTH, np.random.default_rng(2))), 4)
    assert said.verdict in ("effect", "ambiguous"), said.sentence
    assert "equal_points" in set(said.causes["effect"]) <= {"equal_points", "tip_mass"}
