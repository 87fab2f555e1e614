"""Whitened residuals have unit covariance, and estimates keep stated covariances."""

import numpy as np
import pytest

from stringcast.stages.inference.covariance import (
    Linearisation,
    jackknife_covariance,
    variance_inflation,
)
from stringcast.stages.inference.huber import HUBER_LIMIT, huber_weights
from stringcast.stages.inference.whitening import IndependentErrors, LowRankWhitening


def test_whitened_noise_is_white():
    """V = 1 + U U' has almost equal columns: W V W' = 1, and W = V^(-1/2)."""
    rng = np.random.default_rng(0)
    columns = rng.standard_normal((30, 4)) * [10.0, 1.0, 0.1, 3.0]
    columns[:, 3] = columns[:, 0] + 1e-9 * columns[:, 3]
    whiten = LowRankWhitening.from_columns(columns)(np.eye(30))
    np.testing.assert_allclose(
        whiten @ (np.eye(30) + columns @ columns.T) @ whiten.T, np.eye(30), atol=1e-10
    )
    np.testing.assert_allclose(whiten, whiten.T, atol=1e-12)


def test_without_columns_residuals_are_unchanged():
    residual = np.arange(6.0)[None]
    np.testing.assert_array_equal(
        LowRankWhitening.from_columns(np.empty((6, 0)))(residual), residual
    )


@pytest.mark.parametrize("blocks", [60, 12])
def test_intervals_contain_the_truth_if_noise_is_correlated(blocks):
    """Intervals contain the truth if noise is correlated.

    Four parameters are estimated from 600 numbers. Half of their noise is common to a
    block; some parameters are better determined than others. 95 % intervals contain the
    truth in 93 to 98 % of 300 repetitions (a sandwich's in 85 to 94). If all numbers
    are assumed independent, the stated variance is at most a third.
    """
    rng = np.random.default_rng(0)
    block = np.repeat(np.arange(blocks), 600 // blocks)
    slope = (
        30
        * rng.standard_normal((4, blocks))[:, block]
        * rng.gamma(2.0, 0.5, blocks)[block]
    )
    found, held = [], []
    for _ in range(300):
        noise = rng.standard_normal(600) + rng.standard_normal(blocks)[block]
        change = np.linalg.solve(slope @ slope.T, -slope @ noise)
        sure = jackknife_covariance(slope, noise + change @ slope, np.ones(600), block)
        found.append(change)
        held.append(np.abs(change) < sure.half_width_95)
    assert 0.93 < np.mean(held) < 0.98
    assert np.all(np.diag(np.linalg.inv(slope @ slope.T)) < np.var(found, axis=0) / 3)


@pytest.mark.parametrize("copies", [1, 4, 20])
def test_copies_of_a_residual_multiply_the_variance_by_their_number(copies):
    """Every residual is repeated, with its noise and its slopes."""
    rng = np.random.default_rng(0)
    number = np.repeat(np.arange(1200), copies)
    block = number // 20
    slope = 30 * rng.standard_normal((4, 1200))
    noise = rng.standard_normal(1200)
    change = np.linalg.solve(slope @ slope.T, -slope @ noise)
    residual = noise + change @ slope
    repeated = residual[number], slope[:, number]
    linear = Linearisation(*repeated, np.ones(4), np.ones(len(number)), block)
    assert variance_inflation(linear) == pytest.approx(copies, rel=0.15)


def test_an_undetermined_parameter_has_an_interval_as_wide_as_its_range():
    slope = np.array([[100.0] * 50, [0.0] * 50])
    residual = np.random.default_rng(1).standard_normal(50)
    sure = jackknife_covariance(slope, residual, np.ones(50), np.arange(50))
    assert np.sqrt(sure.matrix[1, 1]) == pytest.approx(1 / np.sqrt(12))
    assert sure.half_width_95[1] > 0.5
    assert sure.correlation[0, 1] == pytest.approx(0.0, abs=1e-12)


def test_downweighted_outliers_do_not_widen_intervals():
    """Outliers of small weight do not widen the interval.

    A slope is fitted through noise with one outlier, ten times as large as any other.
    With Huber's weights it is as certain as without the outlier.
    """
    rng = np.random.default_rng(2)
    slope, residual = np.full((1, 200), 20.0), rng.standard_normal(200)
    spoilt = residual.copy()
    spoilt[7] = 30.0
    sure = [
        jackknife_covariance(
            slope, r, huber_weights(r, 2.0), np.arange(200)
        ).half_width_95[0]
        for r in (residual, spoilt)
    ]
    assert sure[1] < 1.1 * sure[0]


def test_a_residual_that_all_blocks_share_does_not_widen_the_interval():
    """Away from the optimum all steps have a common part, which is not scatter."""
    block = np.repeat(np.arange(10), 5)
    slope = np.full((1, 50), 20.0)
    noise = np.random.default_rng(3).standard_normal(50)
    widths = [
        jackknife_covariance(slope, noise + shift, np.ones(50), block).half_width_95[0]
        for shift in (0.0, 5.0)
    ]
    assert widths[1] == pytest.approx(widths[0])


def test_errors_are_whitened_by_their_scale_and_their_shapes():
    rng = np.random.default_rng(4)
    shapes = rng.standard_normal((20, 3))
    alone = IndependentErrors(scale=2.0).whiten(np.eye(20))
    np.testing.assert_allclose(alone, np.eye(20) / 2)
    whiten = IndependentErrors(2.0, shapes).whiten(np.eye(20))
    covariance = 4 * np.eye(20) + shapes @ shapes.T
    np.testing.assert_allclose(whiten @ covariance @ whiten.T, np.eye(20), atol=1e-10)


def test_hubers_limit_costs_one_hundredth_of_normal_noise():
    """Its efficiency is E(psi')^2 / E(psi^2), of normal noise (Huber 1964)."""
    size = np.linspace(-8, 8, 160_001)
    density = np.exp(-(size**2) / 2) / np.sqrt(2 * np.pi) * (size[1] - size[0])
    score = huber_weights(size, HUBER_LIMIT) * size
    is_inside = np.abs(size) < HUBER_LIMIT
    efficiency = np.sum(density[is_inside]) ** 2 / np.sum(density * score**2)
    assert efficiency == pytest.approx(0.989, abs=0.002)
