"""Samples of a normal distribution in a box: those of rejection sampling."""

import numpy as np
import pytest

from stringcast.stages.inference.normal_in_box import sample_normal_in_box

COUNT = 4_000


@pytest.mark.parametrize("correlation", [0.0, -0.97, 0.9999])
def test_samples_are_those_of_rejection(correlation):
    """The box cuts the distribution off-centre, also where it is a narrow valley."""
    sd = np.array([3.0, 0.01])
    lowest, highest = np.array([-1.0, -0.02]), np.array([6.0, 0.03])
    covariance = np.array([[1, correlation], [correlation, 1]]) * np.outer(sd, sd)
    rng = np.random.default_rng(0)
    free = rng.multivariate_normal([0, 0], covariance, 50 * COUNT)
    kept = free[((free >= lowest) & (free <= highest)).all(axis=1)]
    precision = np.linalg.inv(covariance)
    drawn = sample_normal_in_box(precision, lowest, highest, COUNT, rng)
    assert (drawn >= lowest).all()
    assert (drawn <= highest).all()
    for share in (0.05, 0.25, 0.5, 0.75, 0.95):
        expected = np.quantile(kept, share, axis=0)
        found = np.quantile(drawn, share, axis=0)
        assert (np.abs(found - expected) < 0.08 * sd).all()
    along = np.corrcoef(drawn.T)[0, 1]
    assert along == pytest.approx(np.corrcoef(kept.T)[0, 1], abs=0.02)


def test_what_no_data_touches_is_anywhere_in_the_box():
    precision = np.diag([1.0, 1e-30])
    rng = np.random.default_rng(0)
    limits = np.array([-3.0, -2.0]), np.array([3.0, 8.0])
    drawn = sample_normal_in_box(precision, *limits, COUNT, rng)
    assert np.mean(drawn[:, 1]) == pytest.approx(3.0, abs=0.25)
    assert np.std(drawn[:, 1]) == pytest.approx(10 / np.sqrt(12), rel=0.05)


def test_a_zero_that_lies_on_a_face_stays_in_the_box():
    precision = np.array([[1.0, 1.0], [1.0, 1.0 + 1e-6]])
    rng = np.random.default_rng(0)
    limits = np.zeros(2), np.array([np.inf, 5.0])
    drawn = sample_normal_in_box(precision, *limits, COUNT, rng)
    assert np.isfinite(drawn).all()
    assert (drawn >= 0).all()
