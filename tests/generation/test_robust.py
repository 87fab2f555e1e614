"""Motions chosen under uncertainty of string, arm and simulation."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from conftest import other_threads
from scipy.special import ndtr
from scipy.stats import binomtest

from stringcast.data.artifacts import SPEEDS
from stringcast.data.estimates import Estimate
from stringcast.data.schema import DataError
from stringcast.pipeline.settings.typed_settings import bind_stage
from stringcast.stages.generate import race, refine
from stringcast.stages.generate.curves import (
    Curves,
    curves_from_motion,
    first_curves,
    join_curves,
    plain_cast,
)
from stringcast.stages.generate.generate import MotionNotFoundError, arm_faults
from stringcast.stages.generate.hit_probability import (
    BATCH_SIZE,
    CastTask,
    midpoint_tip_path,
    predict_outcome,
    simulate_motions,
)
from stringcast.stages.generate.learning import predictive_sd
from stringcast.stages.generate.prospects import describe_prospects, find_prospects
from stringcast.stages.generate.robust import build_motion_artifact
from stringcast.stages.generate.uncertainty_samples import (
    PlanningUncertainty,
    UncertaintySamples,
    sample_uncertainty,
    stratified_uniforms,
)
from stringcast.stages.model.box import Box
from stringcast.stages.model.engine.implicit_leapfrog import ImplicitLeapfrog
from stringcast.stages.model.hand import resample_joint_motion
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import parameter_exponents
from stringcast.stages.model.string import String
from stringcast.stages.model.target import Target

# implicit steps allow large time steps
STRING = String(0.3, integrator=ImplicitLeapfrog(), largest_step=1e-3)
TARGET = Target(0.4, 0.7, 0.02, 0.04)
NONE = PlanningUncertainty(0.0, 0.0, 0.0)
SETTINGS = {
    "motions": 200,
    "string_samples": 12,
    "cma_iterations": 4,
    "max_restarts": 1,
    "exploration": 0.0,
    "validation": 200,
    "shortest": 0.2,
    "longest": 0.8,
    "alpha": 150.0,
    "fraction": 0.25,
    "uncertainty": NONE,
}
SOFT = {
    "bending_stiffness": 0.05,
    "bending_damping": 2e-4,
    "grasp_stiffness": 0.05,
    "grasp_damping": 1e-3,
}
STIFF = {
    "bending_stiffness": 20.0,
    "bending_damping": 1e-2,
    "grasp_stiffness": 5.0,
    "grasp_damping": 5e-3,
}
COMMON = {
    "axial_stiffness": 1e5,
    "axial_damping": 30.0,
    "linear_drag": 0.3,
    "quadratic_drag": 0.2,
}


def generate_robust(*given, seed, **settings):
    """Generate a robust motion through the stage, with settings as keywords."""
    return bind_stage(
        {"_target_": "stages.generate.robust.generate"} | settings, "generate", "here"
    )(*given, seed=seed)


def generate_plain(*given, seed, **settings):
    """Generate a motion through the stage, for the best string alone."""
    return bind_stage(
        {"_target_": "stages.generate.generate.generate"} | settings, "generate", "here"
    )(*given, seed=seed)


def estimate_of(*strings, rms=0.0):
    """Return an estimate whose draws are these strings; the first is the best."""
    best = COMMON | strings[0]
    parameters = pd.DataFrame({"name": list(best), "value": list(best.values())})
    nothing = pd.DataFrame()
    return Estimate(
        parameters,
        nothing,
        nothing,
        pd.DataFrame({"rms_after": [rms], "mesh_error": [0.0]}),
        pd.DataFrame([COMMON | s for s in strings]),
    )


def simulate_commands(model, motion, values):
    """Simulate strings (K, F, n, 2) under the commands, with another sampling."""
    commands = motion.commands
    joints = resample_joint_motion(
        commands["t"].to_numpy(), commands[["q1", "q2", "q3"]].to_numpy()
    )
    times = np.arange(0, motion.duration, 0.0007)
    return model.simulate_string(joints, values, times).points


@pytest.fixture(scope="module")
def model(arm, camera):
    return Model(STRING, arm, camera)


@pytest.fixture(scope="module")
def first_motion(model):
    """Generate a motion for an unknown string."""
    return generate_robust(model, TARGET, (), None, None, seed=3, **SETTINGS)


def test_predicted_hit_probability_is_the_observed_share(model, first_motion):
    """Hits are counted over 400 other draws of the prior, with a finer sampling."""
    values = sample_uncertainty(
        model, None, NONE, 400, np.random.default_rng(99)
    ).values
    tip = simulate_commands(model, first_motion, values)[:, :, -1]
    found = TARGET.is_crossed_by(tip[:, :-1], tip[:, 1:]).any(axis=1).sum()
    predicted = first_motion.outcome.iloc[0]
    assert 0.1 < predicted["chance"] < 0.95
    spread = np.sqrt(
        predicted["chance"] * (1 - predicted["chance"]) * (1 / 200 + 1 / 400)
    )
    assert abs(found / 400 - predicted["chance"]) < 3.3 * spread
    low, high = binomtest(round(predicted["chance"] * 200), 200).proportion_ci(
        method="wilson"
    )
    assert (predicted["chance_low"], predicted["chance_high"]) == pytest.approx(
        (low, high)
    )


def test_outcomes_do_not_depend_on_batches(model, first_motion):
    """More draws than fit into one batch leave the results of the first unchanged."""
    many = sample_uncertainty(
        model, None, NONE, BATCH_SIZE + 3, np.random.default_rng(8)
    )
    place, curves = CastTask(model, TARGET, ()), curves_from_motion(first_motion)
    every, few = (
        predict_outcome(place, curves, many),
        predict_outcome(place, curves, many.select(slice(3))),
    )
    assert every.hit.shape == (1, BATCH_SIZE + 3)
    np.testing.assert_array_equal(every.distance[:, :3], few.distance)


def test_robust_motion_hits_both_of_two_possible_strings(model):
    """A soft and a stiff string are equally likely.

    Motions for the soft string alone seldom hit the stiff one. The search is short, so
    a motion for one string may remain; its stated chance says so.
    """
    both = estimate_of(SOFT, STIFF)
    draws = sample_uncertainty(model, both, NONE, 60, np.random.default_rng(5))
    settings = {
        "attempts": 20000,
        "batch": 256,
        "shortest": 0.2,
        "longest": 0.8,
        "alpha": 150.0,
        "fraction": 0.25,
    }
    place = CastTask(model, TARGET, ())

    def chance(motion):
        return predict_outcome(place, curves_from_motion(motion), draws).hit.mean()

    robust = [
        generate_robust(model, TARGET, (), None, both, seed=s, **SETTINGS)
        for s in range(5)
    ]
    plain = [
        generate_plain(model, TARGET, (), None, both, seed=s, hits=1, **settings)
        for s in range(4)
    ]
    chances = [chance(motion) for motion in robust]
    assert np.median(chances) == 1.0
    stated = [motion.outcome.iloc[0]["chance"] for motion in robust]
    assert stated == pytest.approx(chances, abs=0.15)
    assert np.mean([chance(motion) for motion in plain]) < 0.7


def test_known_string_is_hit(model):
    motion = generate_robust(
        model, TARGET, (), None, estimate_of(SOFT), seed=1, **SETTINGS
    )
    tip = simulate_commands(model, motion, model.values(COMMON | SOFT)[None])[0, :, -1]
    assert TARGET.is_crossed_by(tip[:-1], tip[1:]).any()
    outcome = motion.outcome.iloc[0]
    assert outcome["chance"] == 1.0
    assert TARGET.distance_to(outcome["tip_x"], outcome["tip_y"]) < 0.002
    assert outcome["t_hit"] <= outcome["duration"]


def test_string_that_touches_an_obstacle_first_does_not_hit(model):
    """Strings predicted to hit reach the target before they touch the wall under it."""
    wall = Box(0.6, 0.35, 0.03, 0.3)
    target = Target(0.75, 0.55, 0.06, 0.06)
    motion = generate_robust(
        model, target, (wall,), None, None, seed=2, **SETTINGS | {"motions": 400}
    )
    draws = sample_uncertainty(model, None, NONE, 60, np.random.default_rng(7))
    outcome = predict_outcome(
        CastTask(model, target, (wall,)), curves_from_motion(motion), draws
    )
    points = simulate_commands(model, motion, draws.values)
    touched = wall.is_crossed_by(points[:, :, :-1], points[:, :, 1:]).any(axis=2)
    before = ~np.logical_or.accumulate(touched, axis=1)
    entered = target.is_crossed_by(points[:, :-1, -1], points[:, 1:, -1])
    assert outcome.hit.any()
    assert (entered & before[:, 1:]).any(axis=1)[outcome.hit[0]].all()
    assert (outcome.free_share[0][touched.any(axis=1)] < 1).all()
    joints = model.arm.joint_positions(motion.commands[["q1", "q2", "q3"]].to_numpy())
    assert not wall.is_crossed_by(joints[:, :-1], joints[:, 1:]).any()


def test_distance_after_a_contact_does_not_count(model):
    """Some strings swing into a wall and come nearer to the target behind it."""
    wall, free = (
        Box(0.6, 0.35, 0.03, 0.3),
        CastTask(model, Target(0.75, 0.55, 0.06, 0.06), ()),
    )
    rng = np.random.default_rng(5)
    curves = first_curves(model.arm, rng, 40, (0.4, 0.6), 100.0)
    draws = sample_uncertainty(model, estimate_of(SOFT), NONE, 1, rng)
    some, none = (
        predict_outcome(replace(free, obstacles=(wall,)), curves, draws),
        predict_outcome(free, curves, draws),
    )
    touched = some.free_share[:, 0] < 1
    assert 5 < touched.sum() < 35
    assert (some.distance >= none.distance).all()
    assert (some.distance[~touched] == none.distance[~touched]).all()
    # these strings came nearer behind the wall
    assert (some.distance[touched] > none.distance[touched]).any()
    assert (some.closeness[touched] < none.closeness[touched]).all()


def test_arm_contact_after_the_hit_counts_as_a_miss(model):
    """A post stands where the hand is at the end, long after the hit."""
    motion = generate_robust(
        model, TARGET, (), None, estimate_of(SOFT), seed=1, **SETTINGS
    )
    joints = model.arm.joint_positions(motion.commands[["q1", "q2", "q3"]].to_numpy())
    x, y = joints[-1, -1]
    post = Box(float(x), float(y), 1e-3, 1e-3)
    assert motion.outcome["t_hit"].iloc[0] < motion.duration - 0.02
    draws = sample_uncertainty(
        model, estimate_of(SOFT), NONE, 4, np.random.default_rng(0)
    )
    free, barred = (
        predict_outcome(
            CastTask(model, TARGET, boxes), curves_from_motion(motion), draws
        )
        for boxes in ((), (post,))
    )
    assert free.hit.all()
    assert not barred.hit.any()


def test_robust_motion_keeps_every_limit_of_the_arm(model):
    slow = replace(
        model,
        arm=replace(model.arm, hand_speed=5.0, acceleration=(120.0, 120.0, 120.0)),
    )
    motion = generate_robust(
        slow, TARGET, (), None, estimate_of(SOFT), seed=4, **SETTINGS
    )
    curves = curves_from_motion(motion)
    angles, speeds = curves.sample(0.0005, motion.duration)
    assert (
        arm_faults(slow.arm, (), *curves.sample(slow.arm.tick, motion.duration)) == ""
    ).all()
    assert (
        np.linalg.norm(slow.arm.grasp_velocity(angles, speeds)[..., :2], axis=-1).max()
        < 5.0 * 1.01
    )
    # the arm holds a commanded speed for a tick, so the commands give its acceleration
    commanded = motion.commands[list(SPEEDS)].to_numpy()
    accelerations = np.diff(commanded, axis=0, prepend=0.0) / slow.arm.tick
    assert np.abs(accelerations).max() <= 120.0
    assert ((angles >= slow.arm.lowest) & (angles <= slow.arm.highest)).all()


def test_motion_does_not_depend_on_the_number_of_threads(model, first_motion):
    with other_threads():
        again = generate_robust(model, TARGET, (), None, None, seed=3, **SETTINGS)
    for table in first_motion.TABLES:
        pd.testing.assert_frame_equal(
            getattr(first_motion, table), getattr(again, table), check_exact=True
        )


def test_samples_follow_the_prior_and_then_the_estimate(model):
    """Before a trial, samples cover the ranges of all parameters that are not known.

    Afterwards they are draws of the estimate, with its misfit as uncertainty.
    """
    rng = np.random.default_rng(0)
    names = model.names
    prior = sample_uncertainty(
        replace(model, start_values={"bending_stiffness": 4.0}),
        None,
        PlanningUncertainty(0.004, 0.01, 0.02),
        4000,
        rng,
    )
    assert (prior.values[:, names.index("bending_stiffness")] == 4.0).all()
    damping = np.log(prior.values[:, names.index("bending_damping")])
    np.testing.assert_allclose(damping.mean(), np.log(np.sqrt(3e-7 * 0.67)), atol=0.2)
    assert prior.tip_sigma == 0.02
    assert prior.tip_normal.std() == pytest.approx(1, rel=0.05)
    assert prior.amplitude.std() == pytest.approx(0.004, rel=0.05)
    assert prior.lag.max() == pytest.approx(0.01, rel=0.01)
    after = sample_uncertainty(
        model,
        estimate_of(SOFT, STIFF, rms=0.003),
        PlanningUncertainty(0.004, 0.01, 0.02),
        4000,
        rng,
    )
    stiffness = after.values[:, names.index("bending_stiffness")]
    assert np.unique(stiffness).tolist() == [0.05, 20.0]
    assert np.mean(stiffness == 20.0) == pytest.approx(0.5, abs=0.04)
    assert after.tip_sigma == 0.003


def test_misfit_of_slow_trials_does_not_lower_the_stated_tip_error(model):
    """The larger of misfit and stated error counts."""
    rng = np.random.default_rng(0)
    for rms, sigma in ((0.003, 0.02), (0.04, 0.04)):
        after = sample_uncertainty(
            model,
            estimate_of(SOFT, rms=rms),
            PlanningUncertainty(0.004, 0.01, 0.02),
            4000,
            rng,
            least_tip_error=0.02,
        )
        assert after.tip_sigma == sigma


def test_each_part_of_a_range_holds_one_stratified_sample(model):
    """Each of 24 draws of an estimate is likewise taken once."""
    rng = np.random.default_rng(0)
    wide = PlanningUncertainty(0.004, 0.01, 0.02)
    known_samples = (wide, 24, rng, stratified_uniforms)
    samples = sample_uncertainty(model, None, *known_samples)
    chi = parameter_exponents(model.parameters, samples.values)
    lag = samples.lag[:, None] / wide.lag
    error = ndtr(samples.tip_normal)
    parts = np.sort((24 * np.concatenate([chi, lag, error], axis=1)), axis=0)
    np.testing.assert_array_equal(np.floor(parts + 1e-9).T, [np.arange(24)] * 11)
    strings = [SOFT | {"bending_stiffness": 1.0 + k} for k in range(24)]
    after = sample_uncertainty(model, estimate_of(*strings), *known_samples)
    assert len(np.unique(after.values, axis=0)) == 24


def test_tip_path_between_ticks_is_a_cubic():
    t = np.arange(8.0)
    path = midpoint_tip_path(np.stack([t**3, 1 - t**2], axis=-1)[None])[0]
    half = np.arange(15) / 2
    np.testing.assert_allclose(
        path[2:-2], np.stack([half**3, 1 - half**2], axis=-1)[2:-2], atol=1e-12
    )


def test_search_that_finds_no_motion_gives_the_reason(model, monkeypatch):
    with pytest.raises(DataError, match="out of reach"):
        generate_robust(
            model, Target(2.0, 0.7, 0.02, 0.04), (), None, None, seed=0, **SETTINGS
        )
    with pytest.raises(DataError, match=r"generate\.shortest"):
        generate_robust(
            model, TARGET, (), None, None, seed=0, **SETTINGS | {"shortest": 2.0}
        )
    monkeypatch.setattr(race, "MAX_BATCHES", 2)
    in_the_way = Box(0.2, 0.2, 0.1, 0.1)
    with pytest.raises(MotionNotFoundError, match="no random motion"):
        generate_robust(model, TARGET, (in_the_way,), None, None, seed=0, **SETTINGS)
    # below the arm, where every string hangs through it
    curtain = Box(0.2, 0.0, 3.0, 1e-6)
    down = Curves(
        np.array([[0.0, -np.pi / 2, 0.0]]), np.array([0.3]), np.zeros((1, 3, 6))
    )
    draws = sample_uncertainty(model, None, NONE, 10, np.random.default_rng(0))
    with pytest.raises(MotionNotFoundError, match="each of 10 likely strings touches"):
        build_motion_artifact(CastTask(model, TARGET, (curtain,)), down, draws, 1)


def test_target_too_small_to_hit_still_gets_a_motion(model):
    """With a known string the search is repeated."""
    tiny = SETTINGS | {"motions": 60, "cma_iterations": 0, "validation": 10}
    target, more = Target(0.4, 0.7, 1e-7, 1e-7), tiny | {"max_restarts": 2}
    motion, first = (
        generate_robust(model, target, (), None, None, seed=0, **some)
        for some in (tiny, more)
    )
    again = generate_robust(model, target, (), None, estimate_of(SOFT), seed=0, **more)
    outcome = motion.outcome.iloc[0]
    assert (outcome["chance"], outcome["chance_low"]) == (0.0, pytest.approx(0.0))
    assert outcome["chance_high"] > 0.2
    assert outcome["prospects"].startswith("A hit is unlikely (probability 0.00): ")
    assert first.outcome["tried"].iloc[0] == outcome["tried"]

    assert again.outcome["tried"].iloc[0] > 1.5 * outcome["tried"]
    assert len(motion.commands) == round(outcome["duration"] / model.arm.tick) + 1


def test_swing_is_more_informative_than_a_string_hanging_at_rest(model):
    """Only bending stiffness is unknown, which a hanging string does not show."""
    rng = np.random.default_rng(0)
    values = np.repeat(model.values(COMMON | SOFT)[None], 24, axis=0)
    values[:, model.names.index("bending_stiffness")] = np.geomspace(0.5, 2.0, 24)
    draws = UncertaintySamples(
        values, np.zeros((24, 3)), np.zeros(24), 0.002, rng.standard_normal((24, 2))
    )
    swing = plain_cast(model.arm, 0.6)
    down = Curves(
        np.array([[0.0, -np.pi / 2, 0.0]]), swing.duration, np.zeros_like(swing.control)
    )
    swung, hung = predictive_sd(
        CastTask(model, TARGET, ()), join_curves([swing, down]), draws, interest=0
    )
    tip = simulate_motions(CastTask(model, TARGET, ()), swing, draws).points[:, :, -1]
    assert hung > 0.8 * np.linalg.norm(tip.std(axis=0), axis=-1).min()
    assert swung < 0.2 * hung


def test_planned_cast_arrives_in_the_wanted_direction(model, first_motion):
    """Without a wanted direction the tip arrives in another one."""
    string = (STIFF,)
    downwards = replace(TARGET, direction=-np.pi / 2, direction_tolerance=0.6)
    values = model.values(COMMON | STIFF)[None]
    shares = {}
    for name, target in (("any", TARGET), ("down", downwards)):
        motion = generate_robust(
            model, target, (), None, estimate_of(*string), seed=3, **SETTINGS
        )
        tip = simulate_commands(model, motion, values)[:, :, -1]
        entered = downwards.is_entered_along(tip, 0.0007)
        shares[name] = bool(entered.any())
        if name == "down":
            assert motion.outcome["chance"].iloc[0] == 1.0
    assert shares == {"any": False, "down": True}


def test_wanted_arrival_lowers_hits_and_raises_distances(model, first_motion):
    curves = curves_from_motion(first_motion)
    strings = sample_uncertainty(model, None, NONE, 40, np.random.default_rng(8))
    fast = replace(TARGET, speed=15.0, speed_tolerance=1.0)
    plain, with_arrival = (
        predict_outcome(CastTask(model, target, ()), curves, strings)
        for target in (TARGET, fast)
    )
    assert (with_arrival.hit <= plain.hit).all()
    assert (with_arrival.distance >= plain.distance).all()
    assert with_arrival.hit.sum() < plain.hit.sum()


def describe_first(task, curves, draws):
    """Find and describe the prospects of the first motion."""
    found = find_prospects(task, curves, 0, draws, draws)
    target = task.target
    row = {"chance": 0.0, "target_x": target.x, "target_y": target.y}
    return found, describe_prospects(pd.Series(row | found))


def test_nearest_box_is_stated_for_an_unreachable_target(model):
    """The stated box is hit, and lies where the tip comes nearest to the target."""
    draws = sample_uncertainty(
        model, estimate_of(SOFT), NONE, 4, np.random.default_rng(0)
    )
    swing = plain_cast(model.arm, 0.6)
    nothing = CastTask(model, Target(0.0, 0.0, 0.02, 0.04), ())
    tip = simulate_motions(nothing, swing, draws).points[0, :, -1]
    target = Target(float(tip[:, 0].max()) + 0.1, float(tip[-1, 1]), 0.02, 0.04)
    task = replace(nothing, target=target)
    found, sentence = describe_first(task, swing, draws)
    assert (found["limit"], found["likely_chance"]) == ("arm", 1.0)
    box = replace(target, x=found["likely_x"], y=found["likely_y"])
    assert predict_outcome(replace(task, target=box), swing, draws).hit.all()
    distance = np.hypot(box.x - target.x, box.y - target.y)
    assert distance == pytest.approx(target.distance_to_centre(tip).min(), abs=1e-9)
    assert f"{1e3 * distance:.0f} mm away" in sentence


def test_prospects_simulate_each_motion_once(model, monkeypatch):
    """One simulation serves for reach, obstacles and nearby boxes."""
    draws = sample_uncertainty(
        model, estimate_of(SOFT), NONE, 4, np.random.default_rng(0)
    )
    swings = join_curves([plain_cast(model.arm, 0.6), plain_cast(model.arm, 0.7)])
    task = CastTask(model, Target(-2.0, 0.0, 0.02, 0.04), ())
    counts = []
    simulate_string = Model.simulate_string

    def count_strings(self, motion, values, times):
        counts.append(len(values))
        return simulate_string(self, motion, values, times)

    monkeypatch.setattr(Model, "simulate_string", count_strings)
    found, _ = describe_first(task, swings, draws)
    assert found == {"limit": "arm"}
    assert sum(counts) == 2 * 4


def test_reason_of_an_unlikely_hit_is_stated(model):
    """Each of two motions hits only one of two strings; then both touch a wall.

    A sure hit has no prospects.
    """
    two = estimate_of(SOFT, STIFF)
    draws = sample_uncertainty(model, two, NONE, 8, np.random.default_rng(0))
    quick = SETTINGS | {"motions": 100, "string_samples": 4, "validation": 20}
    motions = [
        generate_robust(model, TARGET, (), None, estimate_of(string), seed=1, **quick)
        for string in (STIFF, SOFT)
    ]
    for sure in motions:
        assert sure.outcome["chance"].iloc[0] == 1.0
        assert "prospects" not in sure.outcome
    curves = join_curves([curves_from_motion(motion) for motion in motions])
    task = CastTask(model, TARGET, ())
    hits = predict_outcome(task, curves, draws).hit
    assert hits.any(axis=0).all()
    assert not hits[0].all()
    found, sentence = describe_first(task, curves, draws)
    assert found["limit"] == "uncertainty"
    assert found["taught_sd"] <= found["tip_sd"]
    assert "by different motions" in sentence

    around = Box(TARGET.x, TARGET.y, 4 * TARGET.w, 4 * TARGET.h)
    found, sentence = describe_first(replace(task, obstacles=(around,)), curves, draws)
    assert found["limit"] == "obstacle"
    assert "obstacle" in sentence


def test_wanted_arrival_is_stated_as_the_reason_of_a_miss(model):
    """The tip never arrives at 100 m/s."""
    draws = sample_uncertainty(
        model, estimate_of(SOFT), NONE, 4, np.random.default_rng(0)
    )
    swing = plain_cast(model.arm, 0.6)
    anywhere = CastTask(model, Target(0.0, 0.0, 0.02, 0.04), ())
    x, y = simulate_motions(anywhere, swing, draws).points[0, -1, -1]
    target = Target(float(x), float(y), 0.02, 0.04)
    assert predict_outcome(replace(anywhere, target=target), swing, draws).hit.all()
    fast = replace(target, speed=100.0, speed_tolerance=1.0)
    found, sentence = describe_first(replace(anywhere, target=fast), swing, draws)
    assert found["limit"] == "arrival"
    assert "not in the wanted direction or at the wanted speed" in sentence
    far = replace(fast, x=-2.0)
    found, _ = describe_first(replace(anywhere, target=far), swing, draws)
    assert found["limit"] == "arm"


def test_refinement_drops_the_worse_half_of_its_searches(model, monkeypatch):
    """Most simulations go to the best start, and no start becomes worse."""
    task = CastTask(model, TARGET, ())
    draws = sample_uncertainty(model, None, NONE, 4, np.random.default_rng(0))
    space = refine.MotionSpace(model.arm, 0.2, 0.8, 150.0)
    starts = race.sample_feasible_motions(
        task, space, None, 0.25, 4, np.random.default_rng(1)
    ).select(slice(4))
    batches = []

    def count_motions(task, curves, samples):
        batches.append(len(curves.duration))
        return predict_outcome(task, curves, samples)

    monkeypatch.setattr(refine, "predict_outcome", count_motions)
    refined = refine.refine_motions(task, space, starts, draws, 6, 0)
    population = refine.POPULATION_SIZE
    most = np.array([4 * population] * 2 + [2 * population] * 2 + [population] * 2)
    assert batches[0] == 4
    assert (np.array(batches[1:]) <= most).all()
    assert batches[-1] > 0
    before, after = (
        predict_outcome(task, curves, draws).closeness for curves in (starts, refined)
    )
    assert (after >= before).all()
    assert after.max() > before.max()
