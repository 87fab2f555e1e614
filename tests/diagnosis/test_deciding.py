"""Deciding between look-alikes: which motion is proposed, and what is said of it."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import TRUTH, ordinary

from stringcast.stages.diagnose.candidate_motions import (
    DesignSettings,
    sample_motions_within_limits,
    synthetic_trial,
)
from stringcast.stages.diagnose.discrepancy_model import attach_discrepancy_model
from stringcast.stages.diagnose.discretisation import with_second_order_mesh
from stringcast.stages.diagnose.experiment_design import (
    Rivals,
    _most_different_motions,
    design_experiment,
)
from stringcast.stages.generate.curves import Curves
from stringcast.stages.generate.generate import arm_faults
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import fit_hypothesis
from stringcast.stages.model.box import Box
from stringcast.stages.model.effects.arm_lag import ArmLag
from stringcast.stages.model.effects.time_offset import TimeOffset
from stringcast.stages.model.parameter import parameter_exponents, parameter_values

SIGMA = 7e-4
ENOUGH = float(np.log(0.95 / 0.05))
DESIGN = DesignSettings(
    motions=12, shortest=0.2, longest=0.6, alpha=150.0, before=0.1, after=0.1
)


class Lead(TimeOffset):
    """The same by nature, counted the other way."""

    name = "lead"

    @staticmethod
    def times(t, offset):
        return t - offset


class _Like:
    """What `imagined` takes of a trial."""

    def __init__(self, s):
        self.s, self.frame = s, np.zeros(len(s), dtype=int)
        self.sigma = np.full(len(s), SIGMA)


@pytest.fixture(scope="module")
def model(arm):
    return with_second_order_mesh(ordinary(arm))


@pytest.fixture(scope="module")
def slow(model):
    """Two gentle swings of joints that lag by 8 ms, as they would be measured."""
    speeds = np.array([[1.0, 0.6, -0.4, -1.0], [0.5, 0.9, 0.2, -0.8], [0.3] * 4])
    control = np.zeros((2, 3, 6))
    control[..., 1:-1] = np.array([0.8, 1.2])[:, None, None] * speeds
    curves = Curves(
        np.array([[0.3, 0.5, 0.2], [0.6, 0.2, -0.3]]), np.array([0.6, 0.6]), control
    )
    like, late = _Like(np.linspace(0.03, 0.3, 8)), model.with_effects(ArmLag)
    cases = [
        synthetic_trial(model, curves.select(np.array([i])), like, DESIGN)
        for i in range(2)
    ]
    values, rng = (
        late.values({**TRUTH, "arm_lag.time_constant": 0.008})[None],
        np.random.default_rng(0),
    )
    seen = [
        case.sample_at_points(
            late.simulate_observation(case.motion, values, case.times).points
        )[0]
        for case in cases
    ]
    pairs = zip(cases, seen, strict=True)
    return [
        replace(case, points=points + SIGMA * rng.standard_normal(points.shape))
        for case, points in pairs
    ]


def rivals(model, slow, *effects):
    """The base model with each of some effects, all fitted."""
    base = Hypothesis(model)
    data = attach_discrepancy_model(
        slow,
        base,
        parameter_exponents(
            base.parameters, np.array([TRUTH[p.name] for p in base.parameters])
        ),
    )
    fits, sizes = {}, np.zeros(len(slow), dtype=int)
    for effect in effects:
        hypothesis = base.with_cause(effect)
        start = [TRUTH.get(p.name, p.start) for p in hypothesis.parameters]
        fits[effect.name] = fit_hypothesis(
            data,
            hypothesis,
            parameter_exponents(hypothesis.parameters, np.array(start))[None],
            sizes,
        )
    return Rivals(fits, data, ENOUGH)


@pytest.fixture(scope="module")
def contest(model, slow):
    return rivals(model, slow, ArmLag, TimeOffset)


@pytest.fixture(scope="module")
def curves(model):
    return sample_motions_within_limits(model, (), DESIGN, np.random.default_rng(1))


def proposal_of(contest):
    return design_experiment(contest, (), DESIGN, np.random.default_rng(1))


def test_motions_are_within_the_arms_limits_and_clear_of_obstacles(model, curves):
    arm = model.arm
    sampled = curves.sample(arm.tick, float(curves.duration.max()))
    assert len(curves.duration) == DESIGN.motions
    assert (arm_faults(arm, (), *sampled) == "").all()
    wall = Box(0.5, 0.4, 0.1, 0.1)
    around = sample_motions_within_limits(
        model, (wall,), DESIGN, np.random.default_rng(1)
    )
    sampled = around.sample(arm.tick, float(around.duration.max()))
    assert (arm_faults(arm, (wall,), *sampled) == "").all()
    assert not (
        arm_faults(arm, (wall,), *curves.sample(arm.tick, float(curves.duration.max())))
        == ""
    ).all()


def test_joints_that_lag_arrive_where_they_are_sent(model, curves):
    """Or a lag would be told from an offset by a hand that stops short, which none
    does.
    """
    curve = curves.select(np.array([2]))
    case = synthetic_trial(model, curve, _Like(np.array([0.3])), DESIGN)
    late = case.motion.actual_hand_motion(
        model.arm, [(ArmLag, {"time_constant": np.full((1, 1, 1), 0.008)})]
    )
    there = model.arm.grasp_pose(
        curve.sample(model.arm.tick, float(curve.duration[0]))[0][0, -1]
    )
    assert late.end > case.times[-1] - model.arm.tick
    np.testing.assert_allclose(late.pose[0, -1], there, atol=1e-5)


def test_no_motion_takes_any_part_of_the_string_through_an_obstacle(
    model, contest, curves
):
    """Not even where the tip alone is measured, which passes by it."""
    cases = [
        synthetic_trial(
            model, curves.select(np.array([i])), _Like(np.array([0.3])), DESIGN
        )
        for i in range(3)
    ]
    fit = contest.fits["arm_lag"]
    values = parameter_values(fit.hypothesis.parameters, fit.chi[None])
    line = fit.hypothesis.model.simulate_string(
        cases[1].motion, values, cases[1].times
    ).points[0]
    post = Box(*line[0, line.shape[1] // 4], 0.02, 0.02)
    assert not post.is_crossed_by(line[:-1, -1], line[1:, -1]).any()
    assert 1 in _most_different_motions(contest, cases, ())
    assert 1 not in _most_different_motions(contest, cases, (post,))


def test_the_motion_proposed_tells_more_than_others_and_than_what_was_done(
    model, slow, contest, curves
):
    made = proposal_of(contest)
    said = made.next_experiment
    assert said["between"] == ["arm_lag", "time_offset"]
    assert said["inseparable"] == []
    assert said["expected_log_odds"] > ENOUGH
    assert said["probability_to_decide"] > 0.95
    assert (
        said["already_performed"]["expected_log_odds"] < 0.5 * said["expected_log_odds"]
    )
    cases = [
        synthetic_trial(model, curves.select(np.array([i])), slow[0], DESIGN)
        for i in range(0, DESIGN.motions, 4)
    ]
    base = Hypothesis(model)
    chi = parameter_exponents(
        base.parameters, np.array([TRUTH[p.name] for p in base.parameters])
    )
    told = [
        contest.expected_log_odds(attach_discrepancy_model([case], base, chi))[0].min()
        for case in cases
    ]
    assert said["expected_log_odds"] > np.median(told)
    assert len(made.commands) > 20
    assert set(made.predicted["hypothesis"]) == {"arm_lag", "time_offset"}


def test_what_is_the_same_by_nature_is_said_to_be(model, slow):
    alike = proposal_of(rivals(model, slow, Lead, TimeOffset))
    said = alike.next_experiment
    assert said["inseparable"] == [["lead", "time_offset"]]
    assert said["probability_to_decide"] < 0.01
    assert abs(said["expected_log_odds"]) < 0.1
    assert "none tells all of them apart" in said["sentence"]
    assert alike.commands.empty


def test_one_hypothesis_needs_no_experiment(model, slow):
    assert proposal_of(rivals(model, slow, ArmLag)).next_experiment is None
