"""Candidate effects, and places of those that depend on place."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import TRUTH, ordinary
from synthetic_trials import simulate_trial, swing_angles

from stringcast.stages.diagnose.search.contact_search import contact_candidates
from stringcast.stages.diagnose.search.proposals import (
    candidate_effects,
    effects_left_out,
    propose_causes,
)
from stringcast.stages.diagnose.trials.discrepancy_model import attach_discrepancy_model
from stringcast.stages.diagnose.trials.discretisation import with_second_order_mesh
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import evaluate_fit, fit_hypothesis
from stringcast.stages.inference.prepared_trial import prepare_trial
from stringcast.stages.model.library import effects_by_name, find_effects
from stringcast.stages.model.parameter import parameter_values
from tests.tether import TETHER

PLACES = np.array([8, 14, 20])
PLANE = {"contact.stiffness": 2e5, "contact.height": 0.575, "contact.tilt": -1.25}


@pytest.fixture(scope="module")
def model(arm):
    return with_second_order_mesh(ordinary(arm))


def simulate_swings(arm, model, true_model, values, seconds):
    """Simulate two swings, prepared for a model."""
    rng = np.random.default_rng(0)
    trials = []
    for k, angles in enumerate(swing_angles(arm, 2, seconds)):
        seen = simulate_trial(f"t{k}", arm, true_model, values, angles, PLACES, rng)
        trials.append(prepare_trial(model, seen))
    return trials


@pytest.fixture(scope="module")
def trials(arm, model):
    return simulate_swings(arm, model, model, TRUTH, 0.3)


def candidate_names(model, trials):
    candidates = candidate_effects(model, effects_by_name(), trials)
    return {effect.name for effect in candidates}


def sample_planes(data, fit, hypothesis):
    """Sample contact candidates: heights [m] and tilts [rad], (C,) each."""
    candidates = contact_candidates(data, fit, hypothesis, 0).sample()
    values = parameter_values(hypothesis.parameters, candidates)
    names = hypothesis.model.names
    height = values[:, names.index("contact.height")]
    return height, values[:, names.index("contact.tilt")]


def height_above_planes(x, y, height, tilt):
    """Compute the distance of points (...) from planes (C,) [m], (C, ...)."""
    shape = (-1, *[1] * x.ndim)
    tilt = tilt.reshape(shape)
    return np.cos(tilt) * y - np.sin(tilt) * x - height.reshape(shape)


def test_grasp_poses_exclude_effects_on_joints(arm, model, trials):
    posed = [replace(trial, motion=trial.motion.hand_motion(arm)) for trial in trials]
    assert "joint_gain" in candidate_names(model, trials)
    assert "joint_gain" not in candidate_names(model, posed)
    assert "arm_lag" in candidate_names(model, posed)


def test_active_and_excluded_effects_are_not_candidates(model, trials):
    names = candidate_names(model, trials)
    heavier = model.with_effects(*find_effects(["tip_mass"]))
    assert names - candidate_names(heavier, trials) == {"tip_mass"}
    for effect in effects_by_name().values():
        assert not (effect.exclusion_reason and effect.name in names)


def test_no_contact_is_proposed_if_the_string_never_departs(arm, model, trials):
    base = Hypothesis(model)
    chi = base.model.exponents_of_values(TRUTH)
    data = attach_discrepancy_model(trials, base, chi)
    parent = evaluate_fit(data, base, chi)
    assert not propose_causes(data, parent, [effects_by_name()["contact"]], 0)


def test_no_plane_is_proposed_on_the_path_of_the_hand(arm, model, trials):
    base = Hypothesis(model)
    chi = base.model.exponents_of_values(TRUTH)
    data = attach_discrepancy_model(trials, base, chi)
    touching = base.with_cause(effects_by_name()["contact"])
    height, tilt = sample_planes(data, evaluate_fit(data, base, chi), touching)
    assert len(height) > 10
    poses = [trial.motion.actual_hand_motion(arm, ()).pose[0] for trial in trials]
    x, y = np.concatenate(poses)[:, :2].T
    assert (height_above_planes(x, y, height, tilt) > 0).all()


def test_a_plane_is_found_that_one_trial_touches_late(arm, model):
    """A plane in the path of the second swing is found.

    The string penetrates it by 2 cm, in the last 0.05 s.
    """
    base = Hypothesis(model)
    touching = base.with_cause(effects_by_name()["contact"])
    truth = dict.fromkeys(touching.model.names, 0.0) | TRUTH | PLANE
    trials = simulate_swings(arm, model, touching.model, TRUTH | PLANE, 0.6)
    chi = base.model.exponents_of_values(TRUTH)
    data = attach_discrepancy_model(trials, base, chi)
    parent = evaluate_fit(data, base, chi)
    (plane,) = propose_causes(data, parent, [effects_by_name()["contact"]], 0)
    fit = fit_hypothesis(data, plane.hypothesis, plane.starts, parent.grid_points)
    true_fit = evaluate_fit(data, touching, touching.model.exponents_of_values(truth))
    true_gain = true_fit.log_evidence - parent.log_evidence
    assert true_gain > 50
    assert fit.log_evidence - parent.log_evidence > 0.9 * true_gain
    assert fit.values["contact.height"] == pytest.approx(0.575, abs=0.02)
    assert fit.values["contact.tilt"] == pytest.approx(-1.25, abs=0.1)

    # The likeliest planes touch the second string as it departs, and never the first
    height, tilt = (each[:10] for each in sample_planes(data, parent, touching))
    values = parameter_values(base.parameters, chi[None])
    clearance = []
    for trial in data.trials:
        strings = model.simulate_string(trial.motion, values, trial.times)
        x, y = strings.points[0].transpose(2, 0, 1)
        clearance.append(height_above_planes(x, y, height, tilt).min(axis=2))
    assert (clearance[0] > 0).all()
    first = data.trials[1].times[(clearance[1] < 0).argmax(axis=1)]
    assert (first > 0.5).all()


def test_a_users_field_effect_is_proposed_like_wind(arm, model, effects_folder):
    """It depends on place but acts everywhere, and so is not a contact."""
    (effects_folder / "tether.py").write_text(TETHER)
    (tether,) = find_effects(["tether"])
    base = Hypothesis(model)
    pulled = base.with_cause(tether)
    truth = TRUTH | {"tether.strength": 15.0}
    trials = simulate_swings(arm, model, pulled.model, truth, 0.6)
    data = attach_discrepancy_model(trials, base, base.model.exponents_of_values(TRUTH))
    parent = evaluate_fit(data, base, base.model.exponents_of_values(TRUTH))
    (proposal,) = propose_causes(data, parent, [tether], 0)
    fit = fit_hypothesis(data, proposal.hypothesis, proposal.starts, parent.grid_points)
    assert fit.log_evidence - parent.log_evidence > 50
    assert fit.values["tether.strength"] == pytest.approx(15.0, rel=0.1)


def test_every_effect_is_proposed_or_has_a_reason(arm, model):
    """No effect of the library is left out of a diagnosis without a reason."""
    trials = simulate_swings(arm, model, model, TRUTH, 0.6)
    base = Hypothesis(model)
    chi = base.model.exponents_of_values(
        TRUTH | {"linear_drag": 2.0}
    )  # something is wrong
    data = attach_discrepancy_model(trials, base, chi)
    parent = evaluate_fit(data, base, chi)
    library = effects_by_name()
    left_out = effects_left_out(model, library, trials)
    assert {*left_out} <= {effect.name for effect in model.effects} | {
        "box_contact",
        "resolution",
    }
    candidates = candidate_effects(model, library, trials)
    proposed = {
        proposal.effect.name for proposal in propose_causes(data, parent, candidates, 0)
    }
    assert proposed | {*left_out} == {*library}
