"""The surprise test is calibrated, and detects missing effects."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from stringcast.data.artifacts import (
    JOINTS,
    MASKS,
    POINTS,
    READINGS,
    Motion,
    Observation,
    Points,
)
from stringcast.stages.generate.curves import curves_from_motion, plain_cast
from stringcast.stages.generate.generate import command_table, control_point_table
from stringcast.stages.generate.repeated_misfit import hand_paths
from stringcast.stages.inference.likelihood import BLOCK_S
from stringcast.stages.inference.prepared_trial import prepare_trial
from stringcast.stages.model.hand import resample_joint_motion
from stringcast.stages.model.model import Model
from stringcast.stages.surprise.prediction import draw_slow_noise, predict_tips
from stringcast.stages.surprise.surprise import (
    ALARM_P_VALUE,
    NEIGHBOURS,
    distances_from_neighbours,
    measure_surprise,
    run,
)
from tests.conftest import implicit_string

DRAWS = 100
DURATION_S = 0.5
NOISE_M = 0.7e-3
FRAME_TIMES = np.arange(0, DURATION_S, 0.01)
SIGMA_M = np.full(len(FRAME_TIMES), NOISE_M)


def tip_paths(rng, count):
    """Return paths (count, F, 2) [m] that differ by some mm, more towards the end."""
    share = FRAME_TIMES / DURATION_S
    shape = np.stack([np.sin(3 * share), np.cos(3 * share)], axis=-1)
    amount = rng.normal(0, 4e-3, (count, 1, 2))
    delay = rng.normal(0, 3e-3, (count, 1, 1))
    return shape * (1 + delay * share[:, None]) + amount * share[:, None] ** 2


def sample_surprises(offset_m, trials):
    """Test trials whose tip has an offset [m] at the end."""
    rng = np.random.default_rng(0)
    predicted = tip_paths(rng, DRAWS)
    offset = offset_m * (FRAME_TIMES / DURATION_S)[:, None] * [1.0, 0.0]
    found = []
    for path in tip_paths(rng, trials) + offset:
        measured = path + rng.normal(0, NOISE_M, path.shape)
        found.append(measure_surprise(predicted, measured, SIGMA_M, rng))
    return found


def test_p_values_are_uniform_for_trials_drawn_from_the_posterior():
    trials = 200
    found = sample_surprises(0.0, trials)
    assert np.mean([s.p_value <= 0.5 for s in found]) == pytest.approx(0.5, abs=0.15)
    expected = ALARM_P_VALUE * trials
    alarms = sum(surprise.is_surprising for surprise in found)
    assert alarms <= expected + 3 * np.sqrt(expected)


def test_tip_error_of_20_mm_is_a_surprise():
    assert sum(surprise.is_surprising for surprise in sample_surprises(0.02, 40)) >= 38


def circular_paths(rng, count, length_m=0.3):
    """Return paths (count, F, 2) [m] of a tip that rotates by a random angle."""
    turn = rng.uniform(-1, 1, (count, 1)) * FRAME_TIMES / DURATION_S
    return length_m * np.stack([np.sin(turn), np.cos(turn)], axis=-1)


def is_surprising(predicted, path, rng):
    """Return whether a measured path is a surprise."""
    measured = path + rng.normal(0, NOISE_M, path.shape)
    return measure_surprise(predicted, measured, SIGMA_M, rng).is_surprising


def test_small_error_that_no_parameter_explains_is_a_surprise():
    rng = np.random.default_rng(1)
    predicted = circular_paths(rng, 4 * NEIGHBOURS)
    found = [is_surprising(predicted, path, rng) for path in circular_paths(rng, 20)]
    assert sum(found) <= 2
    longer = circular_paths(rng, 20, length_m=0.305)
    assert all(is_surprising(predicted, path, rng) for path in longer)


def test_distances_do_not_depend_on_the_order_of_paths():
    rng = np.random.default_rng(2)
    paths = rng.normal(0, 5e-3, (DRAWS + 1, *tip_paths(rng, 1).shape[1:]))
    order = rng.permutation(len(paths))
    distances = distances_from_neighbours(paths, SIGMA_M)
    permuted = distances_from_neighbours(paths[order], SIGMA_M)
    assert permuted == pytest.approx(distances[order])


def test_distance_is_that_of_mahalanobis():
    rng = np.random.default_rng(3)
    neighbours = tip_paths(rng, NEIGHBOURS)
    path = tip_paths(rng, 1)[0] + 0.01
    scaled = (neighbours / NOISE_M).reshape(NEIGHBOURS, -1)
    covariance = np.eye(scaled.shape[1]) + np.cov(scaled.T, bias=True)
    offset = (path / NOISE_M).ravel() - scaled.mean(axis=0)
    square = offset @ np.linalg.solve(covariance, offset) / len(offset)
    paths = np.concatenate([path[None], neighbours])
    distance = distances_from_neighbours(paths, SIGMA_M)[0]
    assert distance == pytest.approx(np.sqrt(square))


def test_correlation_of_slow_noise_decays_exponentially():
    noise = draw_slow_noise(np.random.default_rng(4), 20_000, FRAME_TIMES)
    lag = np.abs(FRAME_TIMES[:, None] - FRAME_TIMES)
    assert np.cov(noise.T) == pytest.approx(np.exp(-lag / BLOCK_S), abs=0.04)


def joint_angles(motion, late_s=0.0, gain=1.0):
    """Return joint angles with a delay and a gain."""
    t = motion.commands["t"].to_numpy()
    columns = {"t": t}
    for joint in JOINTS:
        planned = motion.commands[joint].to_numpy()
        turned = np.interp(t - late_s, t, planned) - planned[0]
        columns[joint] = planned[0] + gain * turned
    return pd.DataFrame(columns)


def read_tip(model, arm, rng):
    """Return readings of a string whose hand moves with these joint angles."""
    motion = resample_joint_motion(arm["t"].to_numpy(), arm[list(JOINTS)].to_numpy())
    values = model.values({})[None]
    tip = model.simulate_observation(motion, values, FRAME_TIMES).points[0, :, -1]
    tip = tip + rng.normal(0, NOISE_M, tip.shape)
    same = {"t": FRAME_TIMES, "valid": True}
    readings = same | {"frame": np.arange(len(tip)), "reason": ""}
    readings |= {"tip_x": tip[:, 0], "tip_y": tip[:, 1], "tip_sigma": NOISE_M}
    readings["length"] = model.string.length
    points = same | {"s": model.string.length, "x": tip[:, 0], "y": tip[:, 1]}
    points["sigma"] = NOISE_M
    tables = POINTS.check(pd.DataFrame(points)), READINGS.check(pd.DataFrame(readings))
    return Points(*tables, MASKS.empty())


def planned_cast(arm, t_hit=DURATION_S):
    """Return a planned cast with the time of its hit [s]."""
    curves = plain_cast(arm, DURATION_S)
    empty = [Motion.TABLES[name].empty() for name in ("string", "attempts")]
    outcome = pd.DataFrame([{"duration": DURATION_S, "t_hit": t_hit}])
    commands, points = command_table(arm, curves), control_point_table(curves)
    return Motion(commands, points, *empty, outcome)


def narrow_estimate(model, rng, share, draws=DRAWS, misfit=None, mesh_error_m=0.0):
    """Return an estimate of the true values with a relative uncertainty."""
    values = model.values({})
    scale = np.exp(share * rng.standard_normal((draws, len(values))))
    return SimpleNamespace(
        values=lambda: dict(zip(model.names, values, strict=True)),
        draws=pd.DataFrame(values * scale, columns=model.names),
        model_error_m=np.sqrt(2) * NOISE_M,
        mesh_error_m=mesh_error_m,
        misfit=pd.DataFrame() if misfit is None else misfit,
    )


def noise_of_last_cast(arm, motion, rng):
    """Return the misfit table of a cast whose misfit is measurement noise alone."""
    curves = curves_from_motion(motion)
    hand = hand_paths(arm, curves, DURATION_S)[0]
    ticks = arm.tick * np.arange(len(hand))
    noise = rng.normal(0, NOISE_M, (2, len(FRAME_TIMES)))
    columns = {"t": FRAME_TIMES, "x": noise[0], "y": noise[1]}
    columns |= {"mesh_x": 0.0, "mesh_y": 0.0}
    for name, path in zip(("hand_x", "hand_y"), hand.T, strict=True):
        columns[name] = np.interp(FRAME_TIMES, ticks, path)
    return pd.DataFrame(columns)


@pytest.fixture
def run_cast(arm, camera):
    """Return a function that tests a cast with reported and actual joint angles."""
    model = Model(implicit_string(20, 1e-3), arm, camera)
    rng = np.random.default_rng(0)

    def test(
        reported, performed, draws=DRAWS, readable=True, t_hit=DURATION_S, share=0.03
    ):
        motion = planned_cast(arm, t_hit)
        points = read_tip(model, performed(motion), rng)
        readings = points.readings.assign(valid=readable)
        points = Points(points.points, readings, points.masks)
        call = SimpleNamespace(seed=0, setup=SimpleNamespace(model=model))
        estimate = narrow_estimate(model, rng, share, draws)
        trial = SimpleNamespace(arm=reported(motion))
        return run(call, motion, trial, points, None, estimate)

    return test


def turning_too_far(motion):
    return joint_angles(motion, gain=1.04)


def late(motion):
    return joint_angles(motion, late_s=0.02)


@pytest.mark.parametrize("moved", [joint_angles, turning_too_far, late])
def test_deviation_that_the_arm_reports_is_no_surprise(run_cast, moved):
    assert not run_cast(reported=moved, performed=moved).is_surprising


@pytest.mark.parametrize("moved", [turning_too_far, late])
def test_deviation_that_the_arm_does_not_report_is_a_surprise(run_cast, moved):
    assert run_cast(reported=joint_angles, performed=moved).is_surprising


def deviating_later(motion):
    """Return joint angles that differ from the planned ones in the second half."""
    planned = joint_angles(motion)
    later = np.maximum(planned["t"] - DURATION_S / 2, 0)
    return planned.assign(**{joint: planned[joint] + 4 * later for joint in JOINTS})


def test_deviation_after_the_planned_hit_is_ignored(run_cast):
    assert run_cast(joint_angles, deviating_later).is_surprising
    assert not run_cast(
        joint_angles, deviating_later, t_hit=DURATION_S / 2
    ).is_surprising


def test_measurement_noise_of_the_last_cast_is_no_surprise(arm, camera):
    model = Model(implicit_string(20, 1e-3), arm, camera)
    motion = planned_cast(arm, t_hit=0.2)  # the mesh resolves the string until then
    joints = joint_angles(motion)
    rng = np.random.default_rng(5)
    call = SimpleNamespace(seed=0, setup=SimpleNamespace(model=model))
    trial = SimpleNamespace(arm=joints)
    found = []
    for _ in range(20):
        last = noise_of_last_cast(arm, motion, rng)
        estimate = narrow_estimate(model, rng, 1e-4, misfit=last)
        points = read_tip(model, joints, rng)
        found.append(run(call, motion, trial, points, motion, estimate))
    assert sum(surprise.is_surprising for surprise in found) <= 2


def test_gain_error_of_3_percent_is_a_surprise(run_cast):
    """Joints that turn 3 % too far move the tip by up to 11 mm until an early hit.

    The mesh resolves the string until then. A slow error of 2 mm in the prediction
    would hide this (p = 0.04 to 0.29).
    """

    def turning_slightly_too_far(motion):
        return joint_angles(motion, gain=1.03)

    surprise = run_cast(joint_angles, turning_slightly_too_far, t_hit=0.2, share=1e-3)
    assert surprise.is_surprising


def test_mesh_error_is_removed_if_the_estimate_excludes_it(arm, camera):
    """The mean prediction on a coarse mesh then agrees with a much finer one."""
    coarse = Model(implicit_string(20, 1e-3), arm, camera)
    fine = Model(implicit_string(153, 1.25e-4), arm, camera)
    motion = planned_cast(arm, t_hit=0.15)
    joints = joint_angles(motion)
    rng = np.random.default_rng(6)
    points = read_tip(fine, joints, rng)
    seen = Observation("", points.points, points.readings, points.masks, arm=joints)
    trial = prepare_trial(coarse, seen)
    is_early = trial.times <= 0.15  # the string does not whip until then
    trial = replace(trial, times=trial.times[is_early])
    tip = fine.simulate_observation(trial.motion, fine.values({})[None], trial.times)
    tip = tip.points[0, :, -1]

    offsets = []
    for mesh_error_m in (0.0, 1e-3):
        estimate = narrow_estimate(coarse, rng, 1e-6, 2000, mesh_error_m=mesh_error_m)
        predicted = predict_tips(trial, motion, None, estimate, rng)
        offset = predicted.mean(axis=0) - tip
        offsets.append(np.sqrt(np.mean(np.sum(offset**2, axis=1))))
    assert offsets[1] < 0.2 * offsets[0]


def test_no_verdict_without_predictions_or_readings(run_cast):
    for few in ({"draws": 0}, {"draws": 10}, {"readable": False}):
        surprise = run_cast(joint_angles, joint_angles, **few)
        assert np.isnan(surprise.p_value)
        assert not surprise.is_surprising
