"""The probability that a cause is a stand-in, from the remaining misfit."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import quad

from stringcast.stages.diagnose.evidence import stand_ins
from stringcast.stages.diagnose.evidence.stand_ins import (
    LARGEST_RATIO,
    SMALLEST_RATIO,
    explained_shares,
    probability_by_shares,
)
from stringcast.stages.inference.discrepancy_grid import (
    DISCREPANCY_SCALES_M,
    ONSET_SHARES,
)

FROM_MIDDLE = int(np.flatnonzero(ONSET_SHARES == 0.5)[0]) * len(DISCREPANCY_SCALES_M)


def share_of(ratio):
    """Return the explained share at a ratio of remaining to explained displacement."""
    return 1 / (1 + ratio**2)


LEAST_SHARE = share_of(LARGEST_RATIO)
LARGEST_SHARE = share_of(SMALLEST_RATIO)


def test_the_density_of_shares_is_that_of_a_log_uniform_ratio():
    def density(share):
        probability = probability_by_shares(np.array([share]))
        return probability / (1 - probability) / (LARGEST_SHARE - LEAST_SHARE)

    for low, high in ((0.1, 0.2), (0.5, 2.0)):
        found, _ = quad(density, share_of(high), share_of(low))
        expected = np.log(high / low) / np.log(LARGEST_RATIO / SMALLEST_RATIO)
        assert found == pytest.approx(expected, rel=1e-6)


def test_probabilities_are_calibrated_for_causes_and_stand_ins():
    """Causes with a probability of 0.3, 0.5, 0.7 or 0.9 are present as often."""
    rng = np.random.default_rng(0)
    count = 4000
    log_ratio = rng.uniform(np.log(SMALLEST_RATIO), np.log(LARGEST_RATIO), count)
    standing_in = rng.uniform(LEAST_SHARE, LARGEST_SHARE, count)
    shares = np.concatenate([share_of(np.exp(log_ratio)), standing_in])
    is_present = np.repeat([True, False], count)
    stated = np.array([probability_by_shares(np.array([share])) for share in shares])
    for level in (0.3, 0.5, 0.7, 0.9):
        chosen = np.abs(stated - level) < 0.05
        assert is_present[chosen].mean() == pytest.approx(level, abs=0.06)


def test_similar_trials_count_as_one():
    once = probability_by_shares(np.array([0.97]))
    assert probability_by_shares(np.full(50, 0.97)) == pytest.approx(once)
    # a trial in which the unknown hides the cause shows little
    assert probability_by_shares(np.array([0.9])) == pytest.approx(0.5, abs=0.1)
    assert probability_by_shares(np.array([-3.0])) == pytest.approx(0.5, abs=0.1)
    assert probability_by_shares(np.zeros(0)) == 0.5


class Trial(SimpleNamespace):
    """A trial of ten frames with tip and middle of the string; sigma is 1 mm."""

    point_times = np.repeat(0.1 * np.arange(10), 2)
    times = 0.1 * np.arange(10)
    is_tip = np.tile([False, True], 10)

    def displacements_m(self, residual):
        return 1e-3 * residual.reshape(-1, 2)


def displaced(early, late):
    """Return residuals of the tip in x [sigma], and of 99 sigma in the middle."""
    x = np.where(Trial.point_times < 0.45, early, late).astype(float)
    x[~Trial.is_tip] = 99.0
    return np.stack([x, np.zeros_like(x)], axis=1).ravel()


def find_shares(monkeypatch, cause, misfit, left, grid_point):
    """Compute shares of a cause from its early and late tip shifts.

    misfit, left: misfit without the cause and with it.
    """
    data = SimpleNamespace(trials=[Trial()])
    without = SimpleNamespace(residuals=[displaced(*cause)])
    fit = SimpleNamespace(residuals=[displaced(0, 0)], grid_points=[grid_point])
    discrepancies = {id(without): displaced(*misfit), id(fit): displaced(*left)}
    monkeypatch.setattr(
        stand_ins, "mean_discrepancy", lambda data, fit: [discrepancies[id(fit)]]
    )
    return explained_shares(data, without, fit, 1e-3)


@pytest.mark.parametrize(
    ("cause", "left", "grid_point", "expected"),
    [
        ((4, 40), (0, 20), 0, [1 - 200 / 808]),  # over the whole trial
        ((4, 40), (1, 20), FROM_MIDDLE, [1 - 1 / 16]),  # while the model holds
        (
            (0.5, 40),
            (0, 20),
            FROM_MIDDLE,
            [1 - 200 / 800.125],
        ),  # no effect before the onset
        ((0.5, 0.5), (0, 0), FROM_MIDDLE, []),  # no effect at all
    ],
)
def test_shares_are_computed_where_the_model_holds(
    monkeypatch, cause, left, grid_point, expected
):
    """A cause moves the tip by 4 mm before the middle, and by 40 mm after it."""
    found = find_shares(monkeypatch, cause, cause, left, grid_point)
    assert found == pytest.approx(expected, rel=1e-3)


def test_a_trial_without_misfit_does_not_show_what_a_cause_explains(monkeypatch):
    """Another initial state compensates the cause, which moves the tip by 40 mm."""
    found = find_shares(monkeypatch, (4, 40), (0, 0), (0, 0), 0)
    assert not found.size
