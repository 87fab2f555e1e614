"""Trials made of equal mass points, as Eq. 1 is: how many they are."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import TRUTH, ordinary
from test_parts_of_a_diagnosis import SIGMA, base, measured, resolved, swings

from stringcast.stages.diagnose import diagnose, grain
from stringcast.stages.diagnose.evidence import Evidence
from stringcast.stages.diagnose.fit import fitted
from stringcast.stages.diagnose.prepare import Ground, Raw, literal
from stringcast.stages.diagnose.theory import Theory, joined
from stringcast.stages.diagnose.verdict import COARSE
from stringcast.stages.inference.forward import Case
from stringcast.stages.model.hand import joint_motion
from stringcast.stages.model.library import library


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
    assert grain.grain(evidence, fit) == 20


def test_other_equal_points_than_those_configured_are_a_matter_of_resolution(arm, eq1):
    """Where they explain all, it is the configured number that was wrong; where that explains all, nothing was."""
    evidence, theory = chain(arm, eq1, 20), Theory(eq1, (), eq1.names)
    plain = fitted(replace(evidence, segments=(9,)), [theory], [theory.at(TRUTH)], 15)[0]
    ground = Ground(resolved(eq1), evidence, evidence, base(resolved(eq1), evidence), plain, Raw(evidence, True))
    assert diagnose.coarse(literal(ground, library(), 20)) > COARSE
    assert diagnose.coarse(literal(ground, library(), 10)) == pytest.approx(1.0)


def test_a_string_whose_cause_is_known_has_none(arm, eq1):
    """Without it 13 points would do for a tip that is too heavy: they are asked only of what causes leave."""
    evidence = measured(arm, resolved(eq1), {"tip_mass.ratio": 0.1}, trials=2, seconds=0.8)
    plain = base(resolved(eq1), evidence)
    theory = joined(plain.theory, library()["tip_mass"])
    fit = fitted(evidence, [theory], [theory.carried(plain.theory.named(plain.chi))], 15)[0]
    assert grain.grain(evidence, fit) is None


@pytest.mark.long
def test_points_do_not_stand_for_something_else(arm, eq1, monkeypatch):
    """Ten would explain a third of what a tip mass and a tilt of gravity do: a search with them would be for nothing."""
    hidden = {"tip_mass.ratio": 0.1, "gravity_direction.tilt": 0.05}
    evidence = measured(arm, resolved(eq1), hidden, trials=2, seconds=0.8)
    fit = base(resolved(eq1), evidence)
    assert grain.grain(evidence, fit) is None
    monkeypatch.setattr(grain, "MUCH", 1.0)
    assert grain.grain(evidence, fit) == 10


@pytest.mark.parametrize(
    ("off", "beside", "kinds"),
    [
        (2.0, 3.0, [10, "as it is"]),  # 10 points are asked for once more, and were there
        (2.0, 1.5, ["as it is", 10]),
        (20.0, 30.0, ["as it is", 10]),  # so far off, the number of points is the least
    ],
)
def test_the_configured_number_of_points_is_tried_first_where_it_is_near(monkeypatch, off, beside, kinds):
    left = SimpleNamespace(explained=lambda causes: False, floor=None, tried={frozenset(): None})
    ground = SimpleNamespace(configured=SimpleNamespace(mean_square=off), beside_noise=beside)
    data = SimpleNamespace(model=SimpleNamespace(string=SimpleNamespace(points=10)), of_points=lambda points: points)
    made = []
    monkeypatch.setattr(diagnose, "_as_it_is", "as it is")
    monkeypatch.setattr(diagnose, "grain", lambda evidence, fit: 10)
    monkeypatch.setattr(diagnose, "_left", lambda *one: 0.0)
    monkeypatch.setattr(diagnose, "_sought", lambda g, d, kind, progress: made.append(kind) or (g, left, frozenset()))
    diagnose._compared(ground, data, lambda share: None)
    assert made == kinds
