"""Posterior draws follow the directions that the data do not determine."""

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
    """Linearise residuals that depend only on the sum of two values, near given ones."""
    rng = np.random.default_rng(0)
    shape = rng.standard_normal(BLOCKS * FRAMES)
    noise = rng.standard_normal(BLOCKS * FRAMES)
    # without its component along the shape, so that the given sum is the optimum
    noise -= shape * (shape @ noise) / (shape @ shape)
    chi = np.array([p.chi(np.asarray(v)) for p, v in zip(BOTH, values, strict=True)])
    moved = parameter_values(BOTH, chi + STEP) - parameter_values(BOTH, chi)
    slope = sensitivity * moved[:, None] / STEP * shape
    block = np.repeat(np.arange(BLOCKS), FRAMES)
    return chi, Linearisation(
        noise, slope, np.full(2, STEP), np.ones(len(noise)), block
    )


@pytest.mark.parametrize("values", [(1e-4, 0.5), (0.25, 0.25), (0.5, 1e-4)])
def test_draws_cover_a_valley_up_to_both_ends(values):
    """A slow look determines only the sum of two drags.

    Each drag is almost zero in some draws and almost the sum in others.
    """
    chi, linear = linearise_sum(values, sensitivity=100.0)
    share = share_of_blocks(linear)
    drawn = parameter_values(BOTH, sample_posterior(BOTH, chi, linear, share, seed=0))
    assert drawn.sum(axis=1) == pytest.approx(np.full(len(drawn), 0.5), abs=0.01)
    for one in drawn.T:
        assert np.quantile(one, 0.1) < 0.1
        assert np.quantile(one, 0.9) > 0.4


def test_block_counts_as_one_measurement_of_each_coordinate():
    """Model error is correlated within a block of any number of frames."""
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
    # with independent residuals, each counts
    drawn = parameter_values(one, sample_posterior(one, best, known, 1.0, 0))
    assert np.std(drawn) == pytest.approx(1 / np.sqrt(BLOCKS * FRAMES), rel=0.3)


def test_data_without_noise_give_a_narrow_posterior():
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
