"""What is white has a covariance of one; what a covariance promises, estimates keep."""

import numpy as np
import pytest

from stringcast.stages.inference.covariance import sandwich
from stringcast.stages.inference.whitening import LowRank


def test_whitened_noise_is_white():
    """Of V = 1 + U U', with columns that are all but the same: W V W' = 1, and W = V^(-1/2)."""
    rng = np.random.default_rng(0)
    columns = rng.standard_normal((30, 4)) * [10.0, 1.0, 0.1, 3.0]
    columns[:, 3] = columns[:, 0] + 1e-9 * columns[:, 3]
    whiten = LowRank.of(columns)(np.eye(30))
    np.testing.assert_allclose(whiten @ (np.eye(30) + columns @ columns.T) @ whiten.T, np.eye(30), atol=1e-10)
    np.testing.assert_allclose(whiten, whiten.T, atol=1e-12)


def test_without_columns_nothing_is_taken():
    residual = np.arange(6.0)[None]
    np.testing.assert_array_equal(LowRank.of(np.empty((6, 0)))(residual), residual)


def test_the_sandwich_knows_how_estimates_scatter_where_neighbours_share_their_noise():
    """A line through 600 numbers in 60 blocks, half of whose noise is that of the block. Of 300 estimates the variance
    is (mean over these) what is promised, within 15 %, whose own scatter is 8 %; who takes all numbers for independent
    promises a fifth of it. 95 % intervals hold the truth in 92 to 98 % of them."""
    rng = np.random.default_rng(0)
    block = np.repeat(np.arange(60), 10)
    slope = np.stack([np.full(600, 30.0), np.linspace(-50, 50, 600)])
    truth, promised, found, held = np.array([0.4, 0.6]), [], [], []
    for _ in range(300):
        noise = rng.standard_normal(600) + rng.standard_normal(60)[block]
        change = np.linalg.solve(slope @ slope.T, -slope @ noise)
        sure = sandwich(slope, noise + change @ slope, np.ones(600), block)
        promised.append(np.diag(sure.matrix))
        found.append(truth + change)
        held.append(np.abs(change) < sure.reach)
    actual = np.var(found, axis=0)
    np.testing.assert_allclose(np.mean(promised, axis=0), actual, rtol=0.15)
    assert np.all(np.diag(np.linalg.inv(slope @ slope.T)) < 0.25 * actual)
    assert 0.92 < np.mean(held) < 0.98


def test_what_no_data_touches_is_as_wide_as_its_range():
    slope = np.array([[100.0] * 50, [0.0] * 50])
    residual = np.random.default_rng(1).standard_normal(50)
    sure = sandwich(slope, residual, np.ones(50), np.arange(50))
    assert np.sqrt(sure.matrix[1, 1]) == pytest.approx(1 / np.sqrt(12))
    assert sure.reach[1] > 0.5
    assert sure.correlation[0, 1] == pytest.approx(0.0, abs=1e-12)
