"""Which effects are candidates, and where those that depend on place may act."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import TRUTH, ordinary
from performed import performed, swings

from stringcast.stages.diagnose.places import touching
from stringcast.stages.diagnose.prepared import lacking, resolved
from stringcast.stages.diagnose.proposals import candidates, proposals
from stringcast.stages.inference.evidence import evaluated, fitted
from stringcast.stages.inference.forward import case
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.model.library import library, named
from stringcast.stages.model.parameter import chi_of, values_of


@pytest.fixture(scope="module")
def model(arm):
    return resolved(ordinary(arm))


@pytest.fixture(scope="module")
def trials(arm, model):
    """Two swings."""
    rng, places = np.random.default_rng(0), np.array([8, 14, 20])
    made = (performed(f"t{k}", arm, model, TRUTH, swung, places, rng) for k, swung in enumerate(swings(arm, 2, 0.3)))
    return [case(model, observation) for observation in made]


def names(model, trials):
    return {effect.name for effect in candidates(model, library(), trials)}


def test_grasp_poses_leave_out_what_acts_on_joints(arm, model, trials):
    posed = [replace(trial, motion=trial.motion.grasp(arm)) for trial in trials]
    assert "joint_gain" in names(model, trials)
    assert "joint_gain" not in names(model, posed)
    assert "arm_lag" in names(model, posed)


def test_what_is_at_work_or_excluded_is_no_candidate(model, trials):
    weighed = model.with_effects(*named(["tip_mass"]))
    assert names(model, trials) - names(weighed, trials) == {"tip_mass"}
    assert not {effect.name for effect in library().values() if effect.excluded} & names(model, trials)


def test_nothing_stands_where_the_hand_was(arm, model, trials):
    """Of a plane it is asked where the string passes and the hand does not."""
    base = Hypothesis(model)
    chi = chi_of(base.parameters, np.array([TRUTH[p.name] for p in base.parameters]))
    data = lacking(trials, base, chi)
    touched = base.joined(library()["contact"])
    drawn = touching(data, evaluated(data, base, chi), touched, 0).drawn()
    assert len(drawn) > 10
    values = values_of(touched.parameters, drawn)
    height, tilt = (values[:, touched.model.names.index(f"contact.{name}")] for name in ("height", "tilt"))
    hand = np.concatenate([trial.motion.actual(arm, ()).pose[0, :, :2] for trial in trials])
    along = hand[:, 0] * -np.sin(tilt)[:, None] + hand[:, 1] * np.cos(tilt)[:, None]
    assert (along > height[:, None]).all()


def test_a_plane_is_found_that_one_trial_touches_late(arm, model):
    """By 2 cm in the way of the second of two swings, in its last twentieth of a second."""
    base, touched = Hypothesis(model), Hypothesis(model).joined(library()["contact"])
    there = TRUTH | {"contact.stiffness": 2e5, "contact.height": 0.575, "contact.tilt": -1.25}
    rng, places, motions = np.random.default_rng(0), np.array([8, 14, 20]), swings(arm, 2, 0.6)
    seen = [performed(f"t{k}", arm, touched.model, there, q, places, rng) for k, q in enumerate(motions)]
    chi = chi_of(base.parameters, np.array([TRUTH[p.name] for p in base.parameters]))
    data = lacking([case(model, each) for each in seen], base, chi)
    parent = evaluated(data, base, chi)
    (plane,) = proposals(data, parent, [library()["contact"]], 0)
    found = fitted(data, plane.hypothesis, plane.starts, parent.sizes)
    known = np.array([{**dict.fromkeys(touched.model.names, 0.0), **there}[name] for name in touched.model.names])
    true = evaluated(data, touched, chi_of(touched.parameters, known))
    assert true.evidence - parent.evidence > 50
    assert found.evidence - parent.evidence > 0.9 * (true.evidence - parent.evidence)
    assert found.values["contact.height"] == pytest.approx(0.575, abs=0.02)
    assert found.values["contact.tilt"] == pytest.approx(-1.25, abs=0.1)

    likely = values_of(touched.parameters, touching(data, parent, touched, 0).drawn()[:10])
    height, tilt = (likely[:, touched.model.names.index(f"contact.{name}"), None] for name in ("height", "tilt"))
    (x0, y0), (x1, y1) = (
        model.true(trial.motion, values_of(base.parameters, chi[None]), trial.times).points[0].transpose(2, 0, 1)
        for trial in data.trials
    )
    over = [
        (np.cos(tilt)[..., None] * y - np.sin(tilt)[..., None] * x).min(axis=2) - height
        for x, y in ((x0, y0), (x1, y1))
    ]
    assert (over[0] > 0).all()  # nothing touches the first
    first = data.trials[1].times[(over[1] < 0).argmax(axis=1)]
    assert (first > 0.5).all()  # and all of them the second when it departs
