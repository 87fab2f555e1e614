"""Intervals along a curved valley of the likelihood."""

from dataclasses import dataclass

import numpy as np
import pytest

from stringcast.stages.inference.profile import profile_reaches
from stringcast.stages.model.parameter import Parameter

HALF_WIDTH = 2.0
ACROSS = 1e-3  # width of the valley
ALONG = 0.1  # standard deviation along it
X_AND_Y = tuple(Parameter(name, "m", "", -1.0, 1.0, 0.0) for name in "xy")
BEST = np.array([0.5, 0.5])
METRES_PER_EXPONENT = 2.0


@dataclass
class Valley:
    """A valley y = x + bend x^2 that is normal in x."""

    bend: float
    parameters: tuple[Parameter, ...] = X_AND_Y
    limit: float = np.inf
    candidates_at_once: int = 1

    def residuals(self, chi):
        x, y = (METRES_PER_EXPONENT * (chi - BEST)).T
        return np.stack([x / ALONG, (y - x - self.bend * x**2) / ACROSS], axis=1)


def precision_at_best(problem):
    """Return the precision of a normal posterior, by slopes of the residuals."""
    step = 1e-5
    moved = problem.residuals(BEST + step * np.eye(2))
    slopes = (moved - problem.residuals(BEST[None])) / step
    return slopes @ slopes.T


def reaches(bend, indices=(0, 1)):
    """Return how far intervals reach below and above the best exponents."""
    valley = Valley(bend)
    precision = precision_at_best(valley)
    found = profile_reaches(valley, BEST, precision, indices, HALF_WIDTH)
    return METRES_PER_EXPONENT * found


def test_intervals_of_a_straight_valley_are_those_of_a_normal_posterior():
    deviations = np.array([ALONG, np.hypot(ALONG, ACROSS)])
    expected = HALF_WIDTH * np.stack([deviations, deviations], axis=1)
    assert reaches(0.0) == pytest.approx(expected, rel=1e-6)


def test_intervals_of_a_curved_valley_end_where_the_likelihood_has_fallen():
    """The profile of y follows the valley to x = 2 standard deviations."""
    bend = 2.0
    end = HALF_WIDTH * ALONG
    below, above = reaches(bend, [1])[0]
    assert above == pytest.approx(end + bend * end**2, rel=0.05)
    assert below == pytest.approx(end, rel=1e-3)  # at least as far as the normal one


def test_an_interval_ends_at_the_end_of_its_range():
    """The normal interval of an undetermined exponent exceeds its range."""

    class Flat(Valley):
        def residuals(self, chi):
            return super().residuals(chi)[:, :1]

    flat = Flat(0.0)
    found = profile_reaches(flat, BEST, precision_at_best(flat), [1], HALF_WIDTH)
    assert (found > 0.5).all()
