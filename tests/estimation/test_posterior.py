"""Draws of what trials leave possible: they follow what data cannot distinguish."""

import numpy as np
import pytest

from stringcast.stages.estimate.posterior import sample_posterior, share_of_blocks
from stringcast.stages.inference.covariance import Linearisation
from stringcast.stages.model.parameter import Parameter, parameter_values

LINEAR = Parameter("linear", "", "", low=1e-4, high=10.0, start=0.1)
QUADRATIC = Parameter("quadratic", "", "", low=1e-4, high=10.0, start=0.1)
BOTH = (LINEAR, QUADRATIC)
BLOCKS = 30
FRAMES = 40  # of each block
STEP = 1e-3


def linearise_sum(values, sensitivity):
    """Linearise residuals that tell the sum of two values alone, near given ones."""
    rng = np.random.default_rng(0)
    shape = rng.standard_normal(BLOCKS * FRAMES)
    noise = rng.standard_normal(BLOCKS * FRAMES)
    noise -= shape * (shape @ noise) / (shape @ shape)  # the sum is the best
    chi = np.array([p.chi(np.asarray(v)) for p, v in zip(BOTH, values, strict=True)])
    moved = parameter_values(BOTH, chi + STEP) - parameter_values(BOTH, chi)
    slope = sensitivity * moved[:, None] / STEP * shape
    block = np.repeat(np.arange(BLOCKS), FRAMES)
    return chi, Linearisation(
        noise, slope, np.full(2, STEP), np.ones(len(noise)), block
    )


@pytest.mark.parametrize("values", [(1e-4, 0.5), (0.25, 0.25), (0.5, 1e-4)])
def test_draws_follow_a_valley_to_both_of_its_ends(values):
    """A slow look shows the sum of two drags, and its best fit may have either alone.

    Each drag is hardly there in some draws, and nearly alone in others.
    """
    chi, linear = linearise_sum(values, sensitivity=100.0)
    share = share_of_blocks(linear)
    drawn = parameter_values(BOTH, sample_posterior(BOTH, chi, linear, share, seed=0))
    assert drawn.sum(axis=1) == pytest.approx(np.full(len(drawn), 0.5), abs=0.01)
    for one in drawn.T:
        assert np.quantile(one, 0.1) < 0.1
        assert np.quantile(one, 0.9) > 0.4


def test_a_block_counts_as_one_measurement_of_each_coordinate():
    """What a model misses is alike within it, however many frames it has."""
    values = 0.25, 0.25
    chi, linear = linearise_sum(values, sensitivity=1.0)
    known = Linearisation(
        linear.residual, linear.slope[:1], linear.step[:1], linear.weight, linear.block
    )
    one, best = BOTH[:1], chi[:1]
    share = share_of_blocks(known)
    drawn = parameter_values(one, sample_posterior(one, best, known, share, 0))
    relative = 1 / np.sqrt(2 * BLOCKS)
    assert np.std(drawn) == pytest.approx(relative, rel=0.3)
    # every residual, where all are independent
    drawn = parameter_values(one, sample_posterior(one, best, known, 1.0, 0))
    assert np.std(drawn) == pytest.approx(1 / np.sqrt(BLOCKS * FRAMES), rel=0.3)


def test_data_without_noise_leave_hardly_anything_possible():
    chi, linear = linearise_sum((0.25, 0.25), sensitivity=1.0)
    exact = Linearisation(
        0 * linear.residual,
        linear.slope[:1],
        linear.step[:1],
        linear.weight,
        linear.block,
    )
    drawn = sample_posterior(BOTH[:1], chi[:1], exact, share_of_blocks(exact), 0)
    drawn = parameter_values(BOTH[:1], drawn)
    assert drawn == pytest.approx(np.full(drawn.shape, 0.25), abs=1e-3)
