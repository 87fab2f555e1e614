"""Deciding between look-alikes: which motion is proposed, and whether it does what was foretold."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import TRUTH, ordinary

from stringcast.stages.diagnose.casts import Design, imagined, possible
from stringcast.stages.diagnose.evidence import Evidence
from stringcast.stages.diagnose.fit import fitted
from stringcast.stages.diagnose.foretell import DECIDED, _bounded_step
from stringcast.stages.diagnose.prepare import resolved
from stringcast.stages.diagnose.separate import Contest, promising, proposed, trusted
from stringcast.stages.diagnose.theory import Theory, joined
from stringcast.stages.generate.curves import Curves
from stringcast.stages.generate.generate import arm_faults
from stringcast.stages.model.box import Box
from stringcast.stages.model.effects.arm_lag import ArmLag
from stringcast.stages.model.effects.time_offset import TimeOffset

SIGMA = 7e-4
DESIGN = Design(motions=12, shortest=0.2, longest=0.6, alpha=150.0, before=0.1, after=0.1)
FINER = (14, 20)


class Lead(TimeOffset):
    """The same by nature, counted the other way."""

    name = "lead"

    @staticmethod
    def times(t, offset):
        return t - offset


@pytest.fixture(scope="module")
def model(arm):
    return resolved(ordinary(arm))


@pytest.fixture(scope="module")
def slow(arm, model):
    """Two gentle swings of joints that lag by 8 ms, as they would be measured."""
    speeds = np.array([[1.0, 0.6, -0.4, -1.0], [0.5, 0.9, 0.2, -0.8], [0.3] * 4])
    control = np.zeros((2, 3, 6))
    control[..., 1:-1] = np.array([0.8, 1.2])[:, None, None] * speeds
    curves = Curves(np.array([[0.3, 0.5, 0.2], [0.6, 0.2, -0.3]]), np.array([0.6, 0.6]), control)
    like = imagined(model, curves.only(np.array([0])), _Like(np.linspace(0.03, 0.3, 8)), DESIGN)
    cases = [imagined(model, curves.only(np.array([i])), like, DESIGN) for i in range(2)]
    return measured(Evidence(tuple(cases), (10, 14)), model.with_effects(ArmLag), {"arm_lag.time_constant": 0.008}, 0)


class _Like:
    """What `imagined` takes of a trial."""

    def __init__(self, s):
        self.s, self.frame = s, np.zeros(len(s), dtype=int)
        self.sigma = np.full(len(s), SIGMA)


def measured(evidence, model, hidden, seed):
    """Trials as a model has them, with noise."""
    values = model.values({**TRUTH, **hidden})[None]
    seen = evidence.extrapolated(model, values, evidence.segments)
    rng = np.random.default_rng(seed)
    points = [p[0] + SIGMA * rng.standard_normal(p[0].shape) for p in seen]
    return replace(evidence, cases=tuple(replace(c, points=p) for c, p in zip(evidence.cases, points, strict=True)))


def contest_of(evidence, model, *effects):
    """The base model with each of some effects, all fitted."""
    base = Theory(model, (), model.names)
    theories = [base, *(joined(base, effect) for effect in effects)]
    plain, *fits = (fitted(evidence, [t], [t.at(TRUTH)], 15)[0] for t in theories)
    chances = np.full(len(fits), 1 / len(fits))
    return Contest(tuple(e.name for e in effects), tuple(fits), chances, plain, evidence)


@pytest.fixture(scope="module")
def contest(slow, model):
    return contest_of(slow, model, ArmLag, TimeOffset)


@pytest.fixture(scope="module")
def curves(model):
    return possible(model, (), DESIGN, np.random.default_rng(1))


def the_proposal(contest, curves, seed=0, obstacles=()):
    return proposed(contest, contest.evidence, curves, obstacles, DESIGN, np.random.default_rng(seed))


@pytest.fixture(scope="module")
def proposal(contest, curves):
    return the_proposal(contest, curves)


def test_a_rehearsal_knows_as_little_of_how_old_trials_began_as_the_diagnosis(slow, model, curves):
    """What other beginnings explain counts for nothing: as if all were known, more would be promised."""
    rng = np.random.default_rng(0)
    moving = replace(slow, unsure=tuple(rng.standard_normal((2 * len(case.s), 3)) for case in slow.cases))
    contest = contest_of(moving, model, ArmLag, TimeOffset)
    case = imagined(model, curves.only(np.array([0])), slow.cases[0], DESIGN)
    made = contest.rehearsed(trusted(contest, [case], slow.cases[0], slow.segments, FINER))
    for one in made:
        assert len(one.evidence.unsure) == len(one.evidence.cases) == 3
        for old, fit in zip(contest.fits, one.fits, strict=True):
            again = one.evidence.residuals(old.theory.model, old.chi[None])[0][: len(old.residual)]
            np.testing.assert_allclose(again, old.residual, atol=1e-6)
            assert len(fit.residual) == len(one.evidence.trial)


def test_a_chain_as_it_is_configured_is_looked_at_with_its_own_points(contest):
    literal = replace(contest, evidence=replace(contest.evidence, segments=(9,)))
    assert literal.rough == ((9,), (9,))
    assert contest.rough == ((10, 14), (14, 20))


def test_motions_are_within_the_arms_limits_and_clear_of_obstacles(model, curves):
    arm = model.arm
    sampled = curves.sampled(arm.tick, float(curves.duration.max()))
    assert len(curves.duration) == DESIGN.motions
    assert (arm_faults(arm, (), *sampled) == "").all()
    wall = Box(0.5, 0.4, 0.1, 0.1)
    around = possible(model, (wall,), DESIGN, np.random.default_rng(1))
    sampled = around.sampled(arm.tick, float(around.duration.max()))
    assert (arm_faults(arm, (wall,), *sampled) == "").all()
    assert not (arm_faults(arm, (wall,), *curves.sampled(arm.tick, float(curves.duration.max()))) == "").all()


def test_joints_that_lag_arrive_where_they_are_sent(model, curves):
    """Or a lag would be told from an offset by a hand that stops short, which none does."""
    curve = curves.only(np.array([2]))
    case = imagined(model, curve, _Like(np.array([0.3])), DESIGN)
    late = case.motion.really(model.arm, [(ArmLag, {"time_constant": np.full((1, 1, 1), 0.008)})])
    there = model.arm.grasp(curve.sampled(model.arm.tick, float(curve.duration[0]))[0][0, -1])
    assert late.end > case.times[-1] - model.arm.tick
    np.testing.assert_allclose(late.pose[0, -1], there, atol=1e-5)


def test_no_motion_takes_any_part_of_the_string_through_an_obstacle(contest, curves, model):
    """Not even where the tip alone is measured, which passes by it."""
    tip = _Like(np.array([0.3]))
    cases = [imagined(model, curves.only(np.array([i])), tip, DESIGN) for i in range(3)]
    fit = contest.likeliest
    values = fit.theory.model.values(fit.values)[None]
    line = fit.theory.model.true(cases[1].motion, values, cases[1].times).points[0]
    post = Box(*line[0, line.shape[1] // 4], 0.02, 0.02)
    assert not post.crossed(line[:-1, -1], line[1:, -1]).any()
    like = contest.evidence.cases[0]
    assert 1 in promising(contest, cases, like, ())
    assert 1 not in promising(contest, cases, like, (post,))


def test_the_motion_proposed_separates_better_than_others_and_than_what_was_done(contest, curves, proposal):
    said = proposal.next_experiment
    assert said["between"] == ["arm_lag", "time_offset"]
    assert said["inseparable"] == []
    assert said["expected_log_odds"] > DECIDED
    assert said["probability_to_decide"] > 0.95
    assert said["already_performed"]["expected_log_odds"] < 0.5 * said["expected_log_odds"]
    like = contest.evidence.cases[0]
    cases = [imagined(like.model, curves.only(np.array([i])), like, DESIGN) for i in range(len(curves.duration))]
    every = contest.prospects(trusted(contest, cases, like, (10, 14), FINER))
    told = [prospect.expected()[0, 1] for prospect in every]
    assert said["expected_log_odds"] > 2 * np.median(told)


def test_what_is_the_same_by_nature_is_said_to_be(slow, model, curves):
    alike = the_proposal(contest_of(slow, model, Lead, TimeOffset), curves)
    said = alike.next_experiment
    assert said["inseparable"] == [["lead", "time_offset"]]
    assert said["probability_to_decide"] == 0.0
    assert abs(said["expected_log_odds"]) < 0.1
    assert "No motion tells them apart" in said["sentence"]
    assert alike.commands.empty


def test_of_three_the_pair_that_can_be_told_apart_is(slow, model, curves):
    said = the_proposal(contest_of(slow, model, ArmLag, Lead, TimeOffset), curves).next_experiment
    assert said["inseparable"] == [["lead", "time_offset"]]
    assert said["between"] == ["arm_lag", "lead", "time_offset"]
    assert said["expected_log_odds"] > DECIDED


def test_the_order_of_theories_does_not_matter(contest, curves):
    like = contest.evidence.cases[0]
    cases = [imagined(like.model, curves.only(np.array([i])), like, DESIGN) for i in range(4)]
    turned = replace(contest, names=contest.names[::-1], fits=contest.fits[::-1])
    both = [each.prospects(trusted(contest, cases, like, (10, 14), FINER)) for each in (contest, turned)]
    for one, other in zip(*both, strict=True):
        np.testing.assert_allclose(one.expected(), other.expected()[::-1, ::-1], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("number", [1, 4, 8])
def test_what_is_foretold_is_what_noise_makes(contest, curves, model, number):
    """Data of a new trial drawn, and both theories fitted anew to all trials, not linearly: the difference of their
    log-likelihoods. Measured: 18 to 171, within 1.4 of the spreads foretold."""
    like = contest.evidence.cases[0]
    rng = np.random.default_rng(number)
    new = Evidence((imagined(model, curves.only(np.array([number])), like, DESIGN),), (10, 14))
    true, other = contest.prospects(new)[0].rivals
    told = difference(true, other, true.imagined(1.0, 200, rng))
    for data in true.imagined(1.0, 2, rng).T:
        case = replace(new.cases[0], points=(data * new.sigma).reshape(-1, 2))
        every = replace(new, cases=(*contest.evidence.cases, case))
        costs = [fitted(every, [fit.theory], [fit.chi], 6)[0].residual for fit in contest.fits]
        found = float(np.sum(costs[1] ** 2) - np.sum(costs[0] ** 2)) / 2
        assert abs(found - told.mean()) < 3 * told.std()


def test_to_first_order_a_gentle_motion_is_foretold_as_it_is_rehearsed(contest, curves, model):
    gentle = alone(contest, curves, 11)
    told, made = contest.prospects(gentle)[0].expected(), contest.rehearsed(gentle)
    for true, one in enumerate(made):
        np.testing.assert_allclose(one.expected(), told[true], rtol=0.15, atol=1e-6)


def test_a_rehearsal_does_not_believe_a_fit_that_stopped_short(contest, curves):
    """To first order it promises to tell theories apart by what one of them was not fitted to; really fitted, both say
    of the motion what they say after a good fit."""
    violent = alone(contest, curves, 2)
    lag, offset = contest.fits
    values = {**offset.values, "linear_drag": 0.9, "quadratic_drag": 1e-3}
    short = fitted(contest.evidence, [offset.theory], [offset.theory.at(values)], 0)[0]
    stopped = replace(contest, fits=(lag, short))
    right, made = (each.rehearsed(violent)[0].expected()[1] for each in (contest, stopped))
    assert made == pytest.approx(right, rel=0.1)
    assert stopped.prospects(violent)[0].expected()[0, 1] > 3 * right  # measured: 43 for 7


def alone(contest, curves, number):
    """One motion that nobody has made, with what it could be trusted to say."""
    like = contest.evidence.cases[0]
    case = imagined(like.model, curves.only(np.array([number])), like, DESIGN)
    return trusted(contest, [case], like, (10, 14), FINER)


def difference(true, other, data):
    """Of the log-likelihoods in data (n, draws)."""
    return (np.sum(other.refitted(data) ** 2, axis=0) - np.sum(true.refitted(data) ** 2, axis=0)) / 2


def test_a_step_stops_at_the_end_of_a_range_and_the_others_follow():
    normal, chi = np.array([[2.0, 1.0], [1.0, 2.0]]), np.array([[0.9], [0.5]])
    step = _bounded_step(normal, np.array([[-0.6], [0.0]]), chi)
    assert step[:, 0] == pytest.approx([0.1, -0.05])  # the second minimises what is left once the first is held
