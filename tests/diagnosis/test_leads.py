"""Hard-swung strings, whose trials' ends say nothing of why the simulation is off: causes come from the beginnings."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from conftest import TRUTH, ordinary
from performed import performed, said_of

from stringcast.data.schema import DataError
from stringcast.stages.diagnose.evidence import Evidence
from stringcast.stages.diagnose.fit import Fit, fitted
from stringcast.stages.diagnose.hypotheses import SHORTLIST, Hypotheses
from stringcast.stages.diagnose.leads import beginnings, follow, leads
from stringcast.stages.diagnose.theory import Theory, joined
from stringcast.stages.generate.curves import first_curves
from stringcast.stages.generate.generate import arm_faults
from stringcast.stages.inference.forward import case
from stringcast.stages.model.effects.arm_lag import ArmLag
from stringcast.stages.model.library import library

SIGMA = 7e-4
LAG = 0.015
STIFF = TRUTH | {"bending_stiffness": 20.0, "grasp_stiffness": 5.0}


@pytest.fixture(scope="module")
def model(arm):
    return ordinary(arm)


@pytest.fixture(scope="module")
def observations(arm, model):
    """Two of the paper's casts, random and with all the acceleration that it allows; the joints are late."""
    rng = np.random.default_rng(6)
    drawn = first_curves(arm, rng, 256, (0.5, 0.8), 150.0)
    fine = np.flatnonzero(arm_faults(arm, (), *drawn.sampled(arm.tick, 0.8)) == "")[:2]
    real = replace(model, string=replace(model.string, points=30, tip_cell=0.5, grasp_cell=0.5)).with_effects(ArmLag)
    return [_seen(arm, real, drawn.only(fine[k : k + 1]), f"t{k}", rng) for k in range(len(fine))]


def _seen(arm, real, curves, name, rng):
    angles = curves.sampled(arm.tick, float(curves.duration[0]))[0][0]
    angles = np.concatenate([np.repeat(angles[:1], 10, axis=0), angles])
    values = STIFF | {"arm_lag.time_constant": LAG}
    return performed(name, arm, real, values, angles, np.arange(3, real.string.points, 3), rng)


@pytest.mark.long
def test_a_lag_is_found_though_the_base_model_is_nowhere_near(model, observations):
    said = said_of(model, observations, 2)
    assert said.causes["effect"].iloc[0] == "arm_lag", said.finding["sentence"].iloc[0]
    assert set(said.causes["effect"]) <= {"arm_lag", "time_offset"}  # which look alike
    assert said.causes["value"].iloc[0] == pytest.approx(LAG, abs=5e-4)
    assert said.held_out["rms_base"].mean() > 0.03  # a tenth of the string
    assert said.held_out["rms_extended"].mean() < 0.005


def test_beginnings_are_of_every_trial_whenever_it_began(observations):
    late = [replace(o, points=o.points.assign(t=o.points["t"] + k)) for k, o in enumerate(observations)]
    for short in beginnings(late, 0.2):
        assert np.ptp(short.points["t"]) == pytest.approx(0.2, abs=0.0051)


def test_what_could_be_explained_by_another_beginning_is_cut_with_the_points(model, observations):
    cases = tuple(case(model, o) for o in observations)
    unsure = tuple(np.arange(2.0 * len(c.points))[:, None] for c in cases)
    short = Evidence(cases, (10,), unsure).until(0.2)
    for made, moves in zip(short.cases, short.unsure, strict=True):
        np.testing.assert_array_equal(moves[:, 0], np.arange(2.0 * len(made.points)))


def test_what_was_chosen_is_followed_with_each_of_its_parts(model, observations):
    """Of six pairs that fit best none can be added to no cause: one by one is how causes are chosen."""
    theory = Theory(model, (), model.names)
    evidence = Evidence(tuple(case(model, o) for o in observations), (10,))
    hypotheses = Hypotheses(evidence, evidence, evidence, model, library(), 0)
    names = ["arm_lag", "time_offset", "wind", "tip_mass", "rest_curvature"]
    for cost, some in [
        (9, ()),
        (8, names[:1]),
        (7, names[1:2]),
        *((k, p) for k, p in enumerate(combinations(names, 2))),
    ]:
        fit = joined(theory, *(library()[name] for name in some))
        hypotheses.add(Fit(fit, fit.start, np.full(4, float(cost)), np.zeros((4, len(fit.free)))))
    followed = {frozenset(fit.theory.names) for fit in leads(hypotheses, frozenset(names[:2]))}
    assert followed >= {frozenset(names[:1]), frozenset(names[1:2]), frozenset(names[:2])}
    assert len(followed) == SHORTLIST + 2


def test_what_leads_name_pays_for_all_that_was_asked_too(model, observations):
    """Where leads came first the library was never asked beside no cause; it then is beside theirs."""
    theory = Theory(model, (), model.names)
    evidence = Evidence((case(model, observations[0]),), (10,)).until(0.15)
    known = {name: library()[name] for name in ("arm_lag", "wind", "tip_mass")}
    hypotheses = Hypotheses(evidence, evidence, evidence, model, known, 0)
    for some in ((), (ArmLag,)):
        hypotheses.add(fitted(evidence, [joined(theory, *some)], [joined(theory, *some).at(STIFF)], 2)[0])
    hypotheses.contexts[frozenset()] = frozenset({"arm_lag"})
    assert hypotheses.by_chance(frozenset({"arm_lag"})) > 1.0


def test_a_trial_without_a_beginning_leaves_the_court_as_it_was(model, observations):
    """Points that come too late or too seldom for a beginning are no reason to refuse the diagnosis."""
    asked = []

    def early(seconds):
        asked.append(seconds)
        raise DataError("no valid point of the string")

    class Empty:
        evidence = Evidence(tuple(case(model, o) for o in observations), (10,))

    assert follow(Empty(), early) is None
    assert len(asked) == 1
