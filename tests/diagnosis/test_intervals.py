"""The width of the intervals that a diagnosis states."""

from types import SimpleNamespace

import pytest

from stringcast.stages.diagnose.settings import DiagnosisSettings


@pytest.mark.parametrize(("coverage", "deviations"), [(0.95, 1.960), (0.68, 0.9945)])
def test_intervals_are_wider_than_those_of_the_likelihood(coverage, deviations):
    """Without the factor, they contained 87 % of the true values instead of 95 %."""
    settings = SimpleNamespace(criteria=SimpleNamespace(coverage=coverage))
    half_width = DiagnosisSettings.interval_half_width.fget(settings)
    assert half_width == pytest.approx(1.4 * deviations, rel=1e-3)
