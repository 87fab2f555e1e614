"""Trials made by other simulations than the diagnosis' own: of mass points, as Eq. 1 has them."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from conftest import TRUTH as ORDINARY
from conftest import ordinary

from data.artifacts import JOINTS, MASKS, READINGS, Observation
from stages.diagnose.casts import Design
from stages.diagnose.diagnose import diagnose
from stages.estimate.matching import Matching
from stages.generate.curves import Curves
from stages.model.effects.tip_mass import TipMass
from stages.model.hand import joint_motion

SIGMA = 7e-4
TRUTH = ORDINARY | {"bending_stiffness": 6.0, "axial_stiffness": 5e5, "grasp_stiffness": 4.0}


@pytest.fixture(scope="module")
def eq1(arm):
    """The paper's string: ten equal points."""
    return ordinary(arm)


def measured(arm, model, values, rng, trials=2):
    """Observations of swings there and back, with points where the mass points are."""
    for k in range(trials):
        control = np.zeros((1, 3, 6))
        control[0, :, 1:-1] = (3 + k) * np.array([[1.0, 0.6, -0.4, -1.0], [0.5, 0.9, 0.2, -0.8], [0.3] * 4])
        angles = Curves(np.array([[0.3, 0.5, 0.2]]), np.array([0.5]), control).sampled(arm.tick, 0.5)[0][0]
        t = arm.tick * np.arange(len(angles))
        seen = model.seen(joint_motion(t, angles), model.values(values)[None], t).points[0, :, 1:]
        x, y = (seen + SIGMA * rng.standard_normal(seen.shape)).reshape(-1, 2).T
        s = np.tile(model.string.arc_lengths()[1:], len(t))
        points = pd.DataFrame({"t": np.repeat(t, seen.shape[1]), "s": s, "x": x, "y": y, "sigma": SIGMA})
        arm_log = pd.DataFrame({"t": t} | dict(zip(JOINTS, angles.T, strict=True)))
        yield Observation(f"t{k}", points, READINGS.empty(), MASKS.empty(), arm_log)


def verdict(model, observations):
    design = Design(motions=1, shortest=0.4, longest=0.8, alpha=150.0, before=0.05, after=0.1)
    matching = Matching(dilations=20, step_px=2, tip_step_px=3.0, delta_w=0.25)
    return diagnose(model, observations, {}, (), (), seed=0, starts=4, matching=matching, design=design)


def test_the_configured_model_itself_is_left_alone(arm, eq1):
    """It differs from a string without mass points by ten sigmas, which is nobody's fault."""
    said = verdict(eq1, list(measured(arm, eq1, TRUTH, np.random.default_rng(0))))
    assert said.verdict == "none", said.sentence


def test_what_is_hidden_in_such_a_chain_has_the_size_it_has_there(arm, eq1):
    """Against a string without mass points the tip would seem heavier by half a segment, 5.6 %."""
    heavy = eq1.with_effects(TipMass)
    said = verdict(eq1, list(measured(arm, heavy, TRUTH | {"tip_mass.ratio": 0.1}, np.random.default_rng(1))))
    assert said.verdict == "effect"
    found = said.causes[said.causes["parameter"] == "tip_mass.ratio"].iloc[0]
    assert set(said.causes["effect"]) == {"tip_mass"}
    assert found["low"] < 0.1 < found["high"]


def test_a_chain_of_other_points_than_ours_is_a_matter_of_resolution(arm, eq1):
    """Its last point stands for half a segment too much: in gentle swings that may also be a tip mass."""
    other = replace(eq1, string=replace(eq1.string, points=30))
    said = verdict(eq1, list(measured(arm, other, TRUTH, np.random.default_rng(2))))
    assert said.verdict in ("effect", "ambiguous"), said.sentence
    assert "resolution" in set(said.causes["effect"]) <= {"resolution", "tip_mass"}
