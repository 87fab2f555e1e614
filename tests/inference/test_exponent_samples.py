"""Samples of exponents under a likelihood that is normal in values."""

import numpy as np
import pytest

from stringcast.stages.inference.exponent_samples import NormalInValues
from stringcast.stages.model.parameter import Parameter, parameter_values

COUNT = 2_000
LOGARITHMIC = Parameter("drag", "", "", low=1e-4, high=10.0, start=0.1)
EVEN = Parameter("wind", "", "", low=-3.0, high=3.0, start=0.0)
PAIRS = {
    "two drags": (LOGARITHMIC, LOGARITHMIC),
    "a drag and wind": (LOGARITHMIC, EVEN),
}


def sample(parameters, centre, covariance, count=COUNT):
    precision = np.linalg.inv(covariance)
    posterior = NormalInValues(parameters, centre, precision, np.ones(2))
    return posterior.sample(count, np.random.default_rng(0))


def sample_by_rejection(parameters, centre, covariance):
    """Return exponents in the unit square by rejection sampling."""
    chi = np.random.default_rng(1).uniform(0, 1, (1_000_000, 2))
    moved = parameter_values(parameters, chi) - parameter_values(parameters, centre)
    square = np.sum((moved @ np.linalg.inv(covariance)) * moved, axis=1)
    return chi[np.random.default_rng(2).random(len(chi)) < np.exp(-0.5 * square)]


@pytest.mark.parametrize("pair", PAIRS)
@pytest.mark.parametrize("correlation", [0.0, 0.9, -0.98])
def test_samples_agree_with_rejection_sampling(pair, correlation):
    """The valley is curved in exponents, with its ends at the sides of the square."""
    parameters = PAIRS[pair]
    drag, other = parameters
    centre = np.array([drag.chi(np.array(0.5)), other.chi(np.array(0.3))])
    covariance = 0.2 * np.array([[1, correlation], [correlation, 1]])
    expected = sample_by_rejection(parameters, centre, covariance)
    found = sample(parameters, centre, covariance)
    shares = (0.05, 0.25, 0.5, 0.75, 0.95)
    difference = np.quantile(found, shares, axis=0) - np.quantile(
        expected, shares, axis=0
    )
    assert np.abs(difference).max() < 0.06


@pytest.mark.parametrize("centre", [(0.0, 1.0), (0.5, 0.5)])
def test_exponents_of_undetermined_parameters_are_uniform(centre):
    found = sample(PAIRS["a drag and wind"], np.array(centre), 1e12 * np.eye(2))
    assert found.mean(axis=0) == pytest.approx([0.5, 0.5], abs=0.05)
    assert found.std(axis=0) == pytest.approx(np.full(2, 1 / np.sqrt(12)), rel=0.1)


def test_samples_of_exact_data_are_the_solution():
    centre = np.array([0.3, 0.0])
    along = np.array([[1.0, 1.0], [1.0, 1.0 + 1e-9]])
    found = sample(PAIRS["two drags"], centre, 1e-16 * along)
    assert np.isfinite(found).all()
    assert ((found >= 0) & (found <= 1)).all()
    assert found[:, 0] == pytest.approx(np.full(COUNT, 0.3), abs=1e-4)
