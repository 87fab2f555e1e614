"""A motion similar to the last one repeats its misfit; a distant one does not."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from stringcast.stages.generate.curves import join_curves, next_curves, plain_cast
from stringcast.stages.generate.hit_probability import (
    CastTask,
    predict_outcome,
    simulate_motions,
    tip_errors,
)
from stringcast.stages.generate.race import MIN_CHANGE_SHARE, draw_scaled_changes
from stringcast.stages.generate.repeated_misfit import (
    RepeatedMisfit,
    find_repeated_misfit,
    hand_paths,
)
from stringcast.stages.generate.robust import build_motion_artifact, describe_correction
from stringcast.stages.generate.uncertainty_samples import UncertaintySamples
from stringcast.stages.model.model import Model
from stringcast.stages.model.string import String
from stringcast.stages.model.target import Target

SAMPLES = 5
LENGTH_M = 0.3
TICK_S = 0.005
DURATION_S = 0.5
MISFIT_M = (0.03, -0.02)
MODEL_ERROR_M = 0.03


@pytest.fixture
def misfit(arm):
    """Return a misfit that grows in time to MISFIT_M at the end of the motion."""
    times = np.arange(0, DURATION_S + TICK_S / 2, TICK_S)
    tip = times[:, None] / DURATION_S * MISFIT_M
    last = plain_cast(arm, DURATION_S)
    return RepeatedMisfit(arm, last, times, tip, LENGTH_M / 3)


@pytest.fixture
def samples(arm, camera):
    """Return samples of one string whose tip is off by 30 mm at random."""
    model = Model(String(LENGTH_M), arm, camera)
    values = np.repeat(model.values({})[None], SAMPLES, axis=0)
    normal = np.random.default_rng(0).standard_normal((SAMPLES, 2))
    exact = np.zeros((SAMPLES, 3))
    return UncertaintySamples(values, exact, np.zeros(SAMPLES), MODEL_ERROR_M, normal)


def estimate_of(misfit, hand):
    """Return an estimate with this misfit on a hand's path (T, 2) at ticks [m]."""
    table = pd.DataFrame({"t": misfit.times, "x": misfit.tip[:, 0]})
    table = table.assign(y=misfit.tip[:, 1], hand_x=hand[:, 0], hand_y=hand[:, 1])
    return SimpleNamespace(misfit=table)


def test_same_motion_repeats_misfit_and_distant_one_does_not(misfit, samples):
    far = replace(misfit.last, start=misfit.last.start + [1.0, 0, 0])
    curves = join_curves([misfit.last, far])
    errors = tip_errors(misfit, curves, MODEL_ERROR_M, samples.tip_normal)
    random = MODEL_ERROR_M * samples.tip_normal
    assert errors.shape == (2 * SAMPLES, 101, 2)
    for error in errors[:SAMPLES]:
        np.testing.assert_allclose(error, misfit.tip, atol=1e-12)
    at_end = errors[SAMPLES:, -1]
    np.testing.assert_allclose(at_end, random, rtol=1e-3, atol=1e-5)


def test_uncertainty_of_distant_motion_is_the_largest_misfit(misfit, samples):
    """The misfit is three times the model's error halfway, and zero otherwise."""
    tip = np.zeros_like(misfit.tip)
    tip[50:60] = 3 * np.sqrt(2) * MODEL_ERROR_M, 0.0
    far = replace(misfit.last, start=misfit.last.start + [1.0, 0, 0])
    large = replace(misfit, tip=tip)
    errors = tip_errors(large, far, MODEL_ERROR_M, samples.tip_normal)
    random = MODEL_ERROR_M * samples.tip_normal
    before, after = errors[:, 49], errors[:, -1]
    np.testing.assert_allclose(before, random, rtol=1e-3, atol=1e-5)
    np.testing.assert_allclose(after, 3 * random, rtol=1e-3, atol=1e-5)


def test_correlation_ignores_later_hand_motion(arm, misfit):
    late = replace(misfit.last, control=misfit.last.control.copy())
    late.control[..., -2] += 3.0
    correlation = misfit.correlation(late, DURATION_S)[0]
    assert correlation[0] == 1
    assert (np.diff(correlation) <= 0).all()
    # V_4 of the Bezier curve hardly acts in the first third
    assert correlation[33] > 0.999
    assert correlation[-1] < 0.99


def test_correlation_is_a_gaussian_of_hand_path_distance(arm, misfit):
    turned = replace(misfit.last, start=misfit.last.start + [0.1, 0, 0])
    distance = hand_paths(arm, turned, DURATION_S) - hand_paths(
        arm, misfit.last, DURATION_S
    )
    mean_square = np.mean(np.sum(distance[0] ** 2, axis=1))
    expected = np.exp(-0.5 * mean_square / 0.1**2)
    assert misfit.correlation(turned, DURATION_S)[0, -1] == pytest.approx(expected)
    assert 0.3 < expected < 0.95


def test_repeated_misfit_is_included_in_hit_prediction(arm, camera, misfit, samples):
    """A target that the model misses by the misfit is hit by repeating the motion."""
    model = Model(String(LENGTH_M), arm, camera)
    plain = CastTask(model, Target(0.0, 0.0, 0.02, 0.02), ())
    exact = replace(samples, tip_sigma=0.0)
    tips = simulate_motions(plain, misfit.last, exact).points[:, :, -1]
    x, y = tips[0, 80] + misfit.tip[80]
    corrected = CastTask(model, Target(x, y, 0.004, 0.004), (), misfit)
    assert predict_outcome(corrected, misfit.last, samples).hit.all()
    without = replace(corrected, misfit=None)
    assert not predict_outcome(without, misfit.last, samples).hit.any()
    corrected_motions = simulate_motions(corrected, misfit.last, samples)
    corrected_tips = corrected_motions.points[:, :, -1]
    np.testing.assert_allclose(corrected_tips[0], tips[0] + misfit.tip, atol=1e-9)


def test_plan_reports_its_correction(arm, camera, misfit, samples):
    task = CastTask(Model(String(LENGTH_M), arm, camera), None, (), misfit)
    described = describe_correction(task, misfit.last, 0.4)
    assert described["likeness"] == 1
    assert described["correction"] == pytest.approx(0.8 * np.hypot(*MISFIT_M))
    far = replace(misfit.last, start=misfit.last.start + [1.0, 0, 0])
    described = describe_correction(task, far, 0.4)
    assert described["correction"] < 1e-3
    assert describe_correction(replace(task, misfit=None), far, 0.4) == {}


def test_misfit_of_another_motion_is_not_used(arm, camera, misfit, samples):
    task = CastTask(
        Model(String(LENGTH_M), arm, camera), Target(0.4, 0.7, 0.02, 0.04), ()
    )
    last = build_motion_artifact(task, misfit.last, samples, 1)
    same_motion = estimate_of(misfit, misfit.hand_path(last.duration))
    found = find_repeated_misfit(arm, LENGTH_M, last, same_motion)
    np.testing.assert_array_equal(found.tip, misfit.tip)
    np.testing.assert_allclose(found.last.control, misfit.last.control)
    other = estimate_of(misfit, misfit.hand_path(last.duration) + [0.2, 0.0])
    assert find_repeated_misfit(arm, LENGTH_M, last, other) is None
    assert find_repeated_misfit(arm, LENGTH_M, None, same_motion) is None
    assert find_repeated_misfit(arm, LENGTH_M, last, None) is None


def test_changes_of_last_motion_are_log_uniform_in_size(arm):
    curves = plain_cast(arm, DURATION_S)
    rng = np.random.default_rng(1)

    def draw():
        return next_curves(arm, rng, 2000, (0.2, 0.8), 150.0, curves, 0.25)

    changed = draw_scaled_changes(arm, rng, curves, draw)
    whole = np.abs(draw().control - curves.control).mean()
    sizes = np.abs(changed.control - curves.control).mean(axis=(1, 2)) / whole
    assert np.quantile(sizes, [0.02, 0.98]) == pytest.approx(
        [MIN_CHANGE_SHARE, 1.0], rel=0.35
    )
    assert np.median(sizes) == pytest.approx(np.sqrt(MIN_CHANGE_SHARE), rel=0.2)
    ticks = changed.duration / arm.tick
    np.testing.assert_allclose(ticks, np.round(ticks))
