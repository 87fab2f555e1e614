"""Which effects are candidates, and where those that depend on place may act."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import TRUTH, ordinary
from performed import performed, swings

from stringcast.stages.diagnose.contact_search import contact_candidates
from stringcast.stages.diagnose.discrepancy_model import attach_discrepancy_model
from stringcast.stages.diagnose.discretisation import with_second_order_mesh
from stringcast.stages.diagnose.proposals import candidate_effects, propose_causes
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import evaluate_fit, fit_hypothesis
from stringcast.stages.inference.prepared_trial import prepare_trial
from stringcast.stages.model.library import effects_by_name, find_effects
from stringcast.stages.model.parameter import parameter_exponents, parameter_values


@pytest.fixture(scope="module")
def model(arm):
    return with_second_order_mesh(ordinary(arm))


@pytest.fixture(scope="module")
def trials(arm, model):
    """Two swings."""
    rng, places = np.random.default_rng(0), np.array([8, 14, 20])
    made = (
        performed(f"t{k}", arm, model, TRUTH, swung, places, rng)
        for k, swung in enumerate(swings(arm, 2, 0.3))
    )
    return [prepare_trial(model, observation) for observation in made]


def names(model, trials):
    return {
        effect.name for effect in candidate_effects(model, effects_by_name(), trials)
    }


def test_grasp_poses_leave_out_what_acts_on_joints(arm, model, trials):
    posed = [replace(trial, motion=trial.motion.hand_motion(arm)) for trial in trials]
    assert "joint_gain" in names(model, trials)
    assert "joint_gain" not in names(model, posed)
    assert "arm_lag" in names(model, posed)


def test_what_is_at_work_or_excluded_is_no_candidate(model, trials):
    weighed = model.with_effects(*find_effects(["tip_mass"]))
    assert names(model, trials) - names(weighed, trials) == {"tip_mass"}
    assert not {
        effect.name
        for effect in effects_by_name().values()
        if effect.excluded_from_search
    } & names(model, trials)


def test_nothing_stands_where_the_hand_was(arm, model, trials):
    """Of a plane it is asked where the string passes and the hand does not."""
    base = Hypothesis(model)
    chi = parameter_exponents(
        base.parameters, np.array([TRUTH[p.name] for p in base.parameters])
    )
    data = attach_discrepancy_model(trials, base, chi)
    touched = base.with_cause(effects_by_name()["contact"])
    drawn = contact_candidates(data, evaluate_fit(data, base, chi), touched, 0).sample()
    assert len(drawn) > 10
    values = parameter_values(touched.parameters, drawn)
    height, tilt = (
        values[:, touched.model.names.index(f"contact.{name}")]
        for name in ("height", "tilt")
    )
    hand = np.concatenate(
        [trial.motion.actual_hand_motion(arm, ()).pose[0, :, :2] for trial in trials]
    )
    along = hand[:, 0] * -np.sin(tilt)[:, None] + hand[:, 1] * np.cos(tilt)[:, None]
    assert (along > height[:, None]).all()


def test_a_plane_is_found_that_one_trial_touches_late(arm, model):
    """By 2 cm in the way of the second of two swings, in its last twentieth of a
    second.
    """
    base, touched = (
        Hypothesis(model),
        Hypothesis(model).with_cause(effects_by_name()["contact"]),
    )
    there = TRUTH | {
        "contact.stiffness": 2e5,
        "contact.height": 0.575,
        "contact.tilt": -1.25,
    }
    rng, places, motions = (
        np.random.default_rng(0),
        np.array([8, 14, 20]),
        swings(arm, 2, 0.6),
    )
    seen = [
        performed(f"t{k}", arm, touched.model, there, q, places, rng)
        for k, q in enumerate(motions)
    ]
    chi = parameter_exponents(
        base.parameters, np.array([TRUTH[p.name] for p in base.parameters])
    )
    data = attach_discrepancy_model(
        [prepare_trial(model, each) for each in seen], base, chi
    )
    parent = evaluate_fit(data, base, chi)
    (plane,) = propose_causes(data, parent, [effects_by_name()["contact"]], 0)
    found = fit_hypothesis(data, plane.hypothesis, plane.starts, parent.scale_indices)
    known = np.array(
        [
            {**dict.fromkeys(touched.model.names, 0.0), **there}[name]
            for name in touched.model.names
        ]
    )
    true = evaluate_fit(data, touched, parameter_exponents(touched.parameters, known))
    assert true.log_evidence - parent.log_evidence > 50
    assert found.log_evidence - parent.log_evidence > 0.9 * (
        true.log_evidence - parent.log_evidence
    )
    assert found.values["contact.height"] == pytest.approx(0.575, abs=0.02)
    assert found.values["contact.tilt"] == pytest.approx(-1.25, abs=0.1)

    likely = parameter_values(
        touched.parameters, contact_candidates(data, parent, touched, 0).sample()[:10]
    )
    height, tilt = (
        likely[:, touched.model.names.index(f"contact.{name}"), None]
        for name in ("height", "tilt")
    )
    (x0, y0), (x1, y1) = (
        model.simulate_string(
            trial.motion, parameter_values(base.parameters, chi[None]), trial.times
        )
        .points[0]
        .transpose(2, 0, 1)
        for trial in data.trials
    )
    over = [
        (np.cos(tilt)[..., None] * y - np.sin(tilt)[..., None] * x).min(axis=2) - height
        for x, y in ((x0, y0), (x1, y1))
    ]
    assert (over[0] > 0).all()  # nothing touches the first
    first = data.trials[1].times[(over[1] < 0).argmax(axis=1)]
    assert (first > 0.5).all()  # and all of them the second when it departs
