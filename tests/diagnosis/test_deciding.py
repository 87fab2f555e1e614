"""The motion proposed to distinguish look-alikes, and the statements about it."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import TRUTH, ordinary
from synthetic_trials import CRITERIA, SIGMA, SWING

from stringcast.stages.diagnose.proposal import experiment_design
from stringcast.stages.diagnose.proposal.candidate_motions import (
    DesignSettings,
    sample_motions_within_limits,
    synthetic_trial,
)
from stringcast.stages.diagnose.proposal.experiment_design import (
    Rivals,
    _most_different_motions,
    design_experiment,
)
from stringcast.stages.diagnose.trials.discrepancy_model import attach_discrepancy_model
from stringcast.stages.diagnose.trials.discretisation import with_second_order_mesh
from stringcast.stages.generate.curves import Curves
from stringcast.stages.generate.generate import arm_faults
from stringcast.stages.inference.discrepancy_grid import (
    COURSE_COUNT,
    DISCREPANCY_SCALES_M,
)
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import fit_hypothesis
from stringcast.stages.model.box import Box
from stringcast.stages.model.effects.arm_lag import ArmLag
from stringcast.stages.model.effects.time_offset import TimeOffset
from stringcast.stages.model.parameter import parameter_values

LAG_S = 0.008
DESIGN = DesignSettings(
    motions=12, shortest=0.2, longest=0.6, alpha=150.0, before=0.1, after=0.1
)


class Lead(TimeOffset):
    """The time offset with the opposite sign."""

    name = "lead"

    @staticmethod
    def times(t, offset):
        return t - offset


class TrialLike:
    """The fields of a trial that a synthetic trial copies."""

    def __init__(self, s):
        self.s = s
        self.frame = np.zeros(len(s), dtype=int)
        self.sigma = np.full(len(s), SIGMA)


TIP_ONLY = TrialLike(np.array([0.3]))


def select_curve(curves, number):
    return curves.select(np.array([number]))


@pytest.fixture(scope="module")
def model(arm):
    return with_second_order_mesh(ordinary(arm))


@pytest.fixture(scope="module")
def slow_trials(model):
    """Simulate two gentle swings of joints that lag."""
    control = np.zeros((2, 3, 6))
    control[..., 1:-1] = np.array([0.8, 1.2])[:, None, None] * SWING
    start = np.array([[0.3, 0.5, 0.2], [0.6, 0.2, -0.3]])
    curves = Curves(start, np.array([0.6, 0.6]), control)
    like = TrialLike(np.linspace(0.03, 0.3, 8))
    lagging = model.with_effects(ArmLag)
    values = lagging.values({**TRUTH, "arm_lag.time_constant": LAG_S})[None]
    rng = np.random.default_rng(0)
    trials = []
    for number in range(2):
        curve = select_curve(curves, number)
        trial = synthetic_trial(model, curve, like, DESIGN)
        strings = lagging.simulate_observation(trial.motion, values, trial.times)
        clean = trial.sample_at_points(strings.points)[0]
        points = clean + SIGMA * rng.standard_normal(clean.shape)
        trials.append(replace(trial, points=points))
    return trials


def fit_rivals(model, trials, *effects):
    """Fit the base model with each of some effects."""
    base = Hypothesis(model)
    data = attach_discrepancy_model(trials, base, base.model.exponents_of_values(TRUTH))
    no_discrepancy = np.zeros(len(trials), dtype=int)
    fits = {}
    for effect in effects:
        hypothesis = base.with_cause(effect)
        start = hypothesis.model.exponents_of_values(TRUTH)
        fit = fit_hypothesis(data, hypothesis, start[None], no_discrepancy)
        fits[effect.name] = fit
    return Rivals(fits, data, CRITERIA.deciding_log_odds)


@pytest.fixture(scope="module")
def rivals(model, slow_trials):
    return fit_rivals(model, slow_trials, ArmLag, TimeOffset)


def sample_motions(model, obstacles=()):
    rng = np.random.default_rng(1)
    return sample_motions_within_limits(model, obstacles, DESIGN, rng)


@pytest.fixture(scope="module")
def curves(model):
    return sample_motions(model)


def propose(rivals):
    return design_experiment(rivals, (), DESIGN, np.random.default_rng(1))


def is_allowed(arm, obstacles, curves):
    """Return whether each motion respects the limits and avoids the obstacles."""
    sampled = curves.sample(arm.tick, float(curves.duration.max()))
    return arm_faults(arm, obstacles, *sampled) == ""


def test_motions_respect_limits_and_avoid_obstacles(model, curves):
    arm = model.arm
    wall = Box(0.5, 0.4, 0.1, 0.1)
    assert len(curves.duration) == DESIGN.motions
    assert is_allowed(arm, (), curves).all()
    assert is_allowed(arm, (wall,), sample_motions(model, (wall,))).all()
    assert not is_allowed(arm, (wall,), curves).all()


def test_lagging_joints_arrive_at_the_end_of_their_motion(model, curves):
    """Lagging joints arrive at the end of their motion.

    If the motion were cut off, a lag would wrongly be distinguished from an offset.
    """
    arm = model.arm
    curve = select_curve(curves, 2)
    trial = synthetic_trial(model, curve, TIP_ONLY, DESIGN)
    lag = {"time_constant": np.full((1, 1, 1), LAG_S)}
    hand = trial.motion.actual_hand_motion(arm, [(ArmLag, lag)])
    angles, *_ = curve.sample(arm.tick, float(curve.duration[0]))
    assert hand.end > trial.times[-1] - arm.tick
    expected = arm.grasp_pose(angles[0, -1])
    np.testing.assert_allclose(hand.pose[0, -1], expected, atol=1e-5)


def test_no_part_of_the_string_crosses_an_obstacle(model, rivals, curves):
    """No part of the string crosses an obstacle, even if only the tip is measured.

    Only the tip passes it without contact.
    """
    trials = []
    for number in range(3):
        curve = select_curve(curves, number)
        trials.append(synthetic_trial(model, curve, TIP_ONLY, DESIGN))
    fit = rivals.fits["arm_lag"]
    values = parameter_values(fit.hypothesis.parameters, fit.chi[None])
    trial = trials[1]
    strings = fit.hypothesis.model.simulate_string(trial.motion, values, trial.times)
    points = strings.points[0]
    post = Box(*points[0, points.shape[1] // 4], 0.02, 0.02)
    assert not post.is_crossed_by(points[:-1, -1], points[1:, -1]).any()
    assert 1 in _most_different_motions(rivals, trials, ())
    assert 1 not in _most_different_motions(rivals, trials, (post,))


def test_the_proposed_motion_decides_better_than_others(
    model, slow_trials, rivals, curves
):
    proposal = propose(rivals)
    experiment = proposal.next_experiment
    log_odds = experiment["expected_log_odds"]
    assert experiment["between"] == ["arm_lag", "time_offset"]
    assert experiment["inseparable"] == []
    assert log_odds > CRITERIA.deciding_log_odds
    assert experiment["probability_to_decide"] > 0.95
    assert experiment["already_performed"]["expected_log_odds"] < 0.5 * log_odds

    base = Hypothesis(model)
    chi = base.model.exponents_of_values(TRUTH)
    others = []
    for number in range(0, DESIGN.motions, 4):
        curve = select_curve(curves, number)
        trial = synthetic_trial(model, curve, slow_trials[0], DESIGN)
        data = attach_discrepancy_model([trial], base, chi)
        others.append(rivals.expected_log_odds(data)[0].min())
    assert log_odds > np.median(others)
    assert len(proposal.commands) > 20
    assert set(proposal.predicted["hypothesis"]) == {"arm_lag", "time_offset"}
    assert "one distinguishes arm lag and time offset with" in experiment["sentence"]


def test_rivals_stay_look_alikes_if_misfit_may_be_their_difference(
    slow_trials, rivals, monkeypatch
):
    """Relative to noise alone, the measured motions would distinguish them."""
    trial = rivals.data.subset([0])
    certain = rivals.expected_log_odds(trial)[0]
    assert certain[0, 1] > 0
    lacking = replace(rivals)
    monkeypatch.setattr(
        experiment_design, "unexplained_tip_rms", lambda *given: np.array([0.0, 1.0])
    )
    log_odds, predicted = lacking.expected_log_odds(trial)
    assert log_odds[0, 1] == log_odds[1, 0] == 0.0
    assert predicted.keys() == {"arm_lag", "time_offset"}


def test_a_motion_is_planned_with_the_time_course_that_was_found(rivals, monkeypatch):
    """Frames before a late onset keep their weight, so that rivals differ more."""
    monkeypatch.setattr(
        experiment_design, "unexplained_tip_rms", lambda *given: np.zeros(2)
    )
    trial = rivals.data.subset([0])
    scale_index = int(np.searchsorted(DISCREPANCY_SCALES_M, 0.01))
    log_odds = []
    for course in (COURSE_COUNT - 1, COURSE_COUNT - 2):
        found = np.full(2, course * len(DISCREPANCY_SCALES_M) + scale_index)
        fits = {n: replace(f, grid_points=found) for n, f in rivals.fits.items()}
        log_odds.append(replace(rivals, fits=fits).expected_log_odds(trial)[0].min())
    constant, begins_late = log_odds
    assert begins_late > 2 * constant > 0


def test_equal_effects_are_stated_to_be_inseparable(model, slow_trials):
    proposal = propose(fit_rivals(model, slow_trials, Lead, TimeOffset))
    experiment = proposal.next_experiment
    assert experiment["inseparable"] == [["lead", "time_offset"]]
    assert experiment["probability_to_decide"] < 0.01
    assert abs(experiment["expected_log_odds"]) < 0.1
    assert "none distinguishes all of them" in experiment["sentence"]
    assert "does not distinguish lead and time offset." in experiment["sentence"]
    assert proposal.commands.empty


def test_one_hypothesis_needs_no_experiment(model, slow_trials):
    rivals = fit_rivals(model, slow_trials, ArmLag)
    assert propose(rivals).next_experiment is None
