"""Trials made of equal mass points, as Eq. 1 is: how many they are."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import TRUTH, ordinary
from test_parts_of_a_diagnosis import SIGMA, base, measured, resolved, swings

from stages.diagnose.evidence import Evidence
from stages.diagnose.fit import fitted
from stages.diagnose.grain import grain
from stages.diagnose.theory import joined
from stages.estimate.forward import Case
from stages.model.hand import joint_motion
from stages.model.library import library


@pytest.fixture(scope="module")
def eq1(arm):
    return ordinary(arm)


def chain(arm, model, points):
    """Evidence of the swings of so many equal points, seen where they are."""
    made = replace(model, string=replace(model.string, points=points))
    values, rng, cases = made.values(TRUTH)[None], np.random.default_rng(5), []
    for k, angles in enumerate(swings(arm, 2, 0.8)):
        t = arm.tick * np.arange(len(angles))
        motion = joint_motion(t, angles)
        seen = made.seen(motion, values, t).points[0, :, 1:]
        seen = seen.reshape(-1, 2) + SIGMA * rng.standard_normal((seen.shape[0] * seen.shape[1], 2))
        frame, s = np.repeat(np.arange(len(t)), points - 1), np.tile(made.string.arc_lengths()[1:], len(t))
        cases.append(Case(f"t{k}", model, motion, t, frame, s, seen, np.full(len(s), SIGMA)))
    return Evidence(tuple(cases), (10, 14))


def test_equal_points_are_counted(arm, eq1):
    evidence = chain(arm, eq1, 20)
    fit = base(resolved(eq1), evidence)
    assert fit.mean_square > 1.2
    assert grain(evidence, fit) == 20


def test_a_string_whose_cause_is_known_has_none(arm, eq1):
    """Without it 13 points would do for a tip that is too heavy: they are asked only of what causes leave."""
    evidence = measured(arm, resolved(eq1), {"tip_mass.ratio": 0.1}, trials=2, seconds=0.8)
    plain = base(resolved(eq1), evidence)
    theory = joined(plain.theory, library()["tip_mass"])
    fit = fitted(evidence, [theory], [theory.carried(plain.theory.named(plain.chi))], 15)[0]
    assert grain(evidence, fit) is None
