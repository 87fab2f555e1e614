"""Noise of a camera whose readings are not independent.

It is separated from motion, and correlated readings have less weight.
"""

from __future__ import annotations

import weakref
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import toeplitz

from stringcast.stages.inference.basis import (
    PLACE_FUNCTIONS,
    SmoothFunctions,
    place_functions,
    time_splines,
)
from stringcast.stages.inference.discrepancy import Discrepancy
from stringcast.stages.inference.discrepancy_basis import DiscrepancyBasis
from stringcast.stages.inference.discrepancy_grid import DISCREPANCY_SCALES_M
from stringcast.stages.inference.noise import (
    WHITE_NOISE,
    Noise,
    fit_noise_model,
    gram_roots,
    noise_track,
)
from stringcast.stages.inference.noise_basis import JointNoiseBasis, find_noise_basis
from stringcast.stages.inference.prepared_trial import PreparedTrial
from stringcast.stages.model.hand import resample_hand_motion
from stringcast.stages.model.model import Model
from stringcast.stages.model.string import String

FRAMES, PLACES_SEEN = 120, 14
# share of the neighbour's noise; correlation with the previous frame
SHARE, BEFORE = 0.4, 0.3
T = np.arange(FRAMES) / 120
S = 0.3 * np.linspace(0.1, 1.0, PLACES_SEEN)


@pytest.fixture
def trial(arm, camera):
    """Return a trial of 120 frames; only its times and places matter."""
    frame, s = (a.ravel() for a in np.meshgrid(np.arange(FRAMES), S, indexing="ij"))
    grasp = np.repeat([[0.1, 0.4, -np.pi / 2]], FRAMES, axis=0)
    still = np.zeros((len(s), 2))
    motion = resample_hand_motion(T, grasp)
    return PreparedTrial(
        "t",
        Model(String(0.3), arm, camera),
        motion,
        T,
        frame,
        s,
        still,
        np.full(len(s), 1e-3),
    )


def along_string():
    """Return the covariance of places in a frame, (n, n).

    Each place shares noise with its neighbour.
    """
    return toeplitz([1.0, SHARE / (1 + SHARE**2), *np.zeros(PLACES_SEEN - 2)])


def noisy(rng, count=1):
    """Draw residuals over sigma, (count, n, 2).

    They are correlated along the string and with the previous frame.
    """
    in_time = np.linalg.cholesky(toeplitz(BEFORE ** np.arange(FRAMES)))
    in_place = np.linalg.cholesky(along_string())
    white = rng.standard_normal((count, FRAMES, 2 * PLACES_SEEN))
    rows = (in_time @ white).reshape(-1, PLACES_SEEN, 2)
    return (in_place @ rows).reshape(count, -1, 2)


def of_places(covariance):
    """Return the covariance of orthonormal functions of place, (PLACES, PLACES).

    It follows from a covariance of points (n, n).
    """
    place = place_functions(S, 0.3)
    inverse = np.linalg.pinv(
        gram_roots((place.T @ place)[None])[0],
        hermitian=True,
        rcond=1e-4,
    )
    return inverse @ place.T @ covariance @ place @ inverse


OF_MEANS = (
    np.trace(of_places(along_string())) / PLACE_FUNCTIONS * (1 + BEFORE) / (1 - BEFORE)
)


def test_noise_correlation_is_estimated_despite_large_motion(trial):
    rng, swing = (
        np.random.default_rng(0),
        40 * np.sin(15 * T[trial.frame] + 4 * trial.s) * trial.s / 0.3,
    )
    found = fit_noise_model(
        [noise_track(trial, each + swing[:, None]) for each in noisy(rng, 4)]
    )
    assert found.frame_correlation == pytest.approx(BEFORE, abs=0.07)
    assert np.linalg.eigvalsh(found.place_covariance) == pytest.approx(
        np.linalg.eigvalsh(of_places(along_string())), rel=0.2
    )
    assert found.variance_of_means == pytest.approx(OF_MEANS, rel=0.2)


def test_white_noise_is_white(trial):
    white = np.random.default_rng(1).standard_normal((4, len(trial.s), 2))
    found = fit_noise_model([noise_track(trial, each) for each in white])
    assert found.frame_correlation < 0.1
    assert found.variance_of_means == pytest.approx(1.0, abs=0.15)


def test_misfit_in_two_of_five_trials_does_not_raise_the_noise(trial):
    rng, crack = (
        np.random.default_rng(2),
        8 * np.sin(250 * T[trial.frame]) * trial.s / 0.3,
    )
    residuals = noisy(rng, 5)
    residuals[:2] += crack[:, None]
    found = fit_noise_model([noise_track(trial, each) for each in residuals])
    assert found.variance_of_means == pytest.approx(OF_MEANS, rel=0.25)
    assert (
        fit_noise_model(
            [noise_track(trial, each) for each in residuals[:2]]
        ).variance_of_means
        > 2 * OF_MEANS
    )


def dense_products(time, place):
    """Multiply functions of time (n, B) by functions of place (n, K), (n, K B)."""
    products = place[:, :, None] * time[:, None, :]
    return products.reshape(len(time), -1)


def test_sums_over_a_film_have_the_variance_of_the_dense_covariance(trial):
    noise = Noise(of_places(along_string()) + 1e-9 * np.eye(PLACE_FUNCTIONS), BEFORE)
    time, place = time_splines(T), place_functions(trial.s, 0.3)
    splines = dense_products(time[trial.frame], place)
    dense = np.kron(toeplitz(BEFORE ** np.arange(FRAMES)), along_string())
    expected = splines.T @ dense @ splines
    smooth = SmoothFunctions(time, place, trial.frame)
    roots = gram_roots(smooth.gram_by_frame(np.ones(len(place))))
    assert noise.covariance(time, roots) == pytest.approx(
        expected, abs=1e-5 * np.abs(expected).max()
    )


@pytest.mark.parametrize("missing", [0, 5])
def test_correlated_noise_is_white_in_the_coefficients(trial, missing):
    """With missing points, time and place do not separate."""
    kept = np.arange(len(trial.s)) >= missing
    seen = trial.select_points(kept)
    in_place = place_functions(seen.s, 0.3)
    smooth = SmoothFunctions(time_splines(T), in_place, seen.frame)
    roots = gram_roots(smooth.gram_by_frame(np.ones(len(in_place))))
    noise = Noise(of_places(along_string()) + 1e-9 * np.eye(PLACE_FUNCTIONS), BEFORE)
    basis = find_noise_basis(replace(seen, noise=noise))
    assert isinstance(basis, JointNoiseBasis) == (missing > 0)

    # Residuals of x whose covariance in smooth functions is that of the noise
    splines = dense_products(time_splines(T)[seen.frame], in_place)
    values, vectors = np.linalg.eigh(noise.covariance(smooth.in_time, roots))
    sums = vectors * np.sqrt(values)
    residuals = np.zeros((len(values), len(seen.s), 2))
    residuals[:, :, 0] = (splines @ np.linalg.solve(splines.T @ splines, sums)).T
    of_x = basis.coefficients(residuals.reshape(len(values), -1))[::2]
    assert of_x.T @ of_x == pytest.approx(np.eye(of_x.shape[1]), abs=1e-5)


def test_estimates_of_smooth_motion_have_their_stated_uncertainty(trial):
    """The stated uncertainty of a smooth motion is its scatter.

    In 400 samples of noise, an amplitude varies by one stated deviation if the correlation
    is known. If noise is assumed independent, it varies by much more.
    """
    motion = np.repeat(
        (np.sin(9 * T[trial.frame]) * trial.s / 0.3)[:, None], 2, axis=1
    ).ravel()
    residuals = noisy(np.random.default_rng(3), 400).reshape(400, -1)

    def scatter(noise):
        one = Discrepancy.for_trial(
            replace(trial, noise=noise),
            np.ones(FRAMES),
            np.zeros((2 * len(trial.s), 0)),
        )
        shape, white = (
            one.whiten_coefficients(one.coefficients(each), 0)
            for each in (motion[None], residuals)
        )
        return float(np.std(white @ shape[0] / np.linalg.norm(shape)))

    assert scatter(
        Noise(of_places(along_string()) + 1e-9 * np.eye(PLACE_FUNCTIONS), BEFORE)
    ) == pytest.approx(1.0, abs=0.1)
    assert scatter(WHITE_NOISE) > 1.5


def test_a_discrepancy_is_located_under_any_noise(trial):
    lacks = np.stack(
        [30 * np.sin(9 * T[trial.frame] + 3 * trial.s) * trial.s / 0.3] * 2, axis=1
    ).ravel()
    for noise in (
        WHITE_NOISE,
        Noise(of_places(along_string()) + 1e-9 * np.eye(PLACE_FUNCTIONS), BEFORE),
    ):
        one = Discrepancy.for_trial(
            replace(trial, noise=noise),
            np.ones(FRAMES),
            np.zeros((2 * len(trial.s), 0)),
        )
        found = one.posterior_mean(
            one.coefficients(lacks[None])[0],
            int(np.searchsorted(DISCREPANCY_SCALES_M, 0.1)),
        )
        assert found == pytest.approx(lacks, abs=0.5)


def test_trials_with_equal_places_times_noise_and_growth_share_a_basis(trial):
    """Corrected points have the same basis, as long as it is in use."""
    growth = np.ones(FRAMES)
    basis = DiscrepancyBasis.for_trial(trial, growth)
    corrected = replace(trial, points=trial.points + 1e-3)
    assert DiscrepancyBasis.for_trial(corrected, growth) is basis
    changed = [
        replace(trial, noise=Noise(np.eye(PLACE_FUNCTIONS), BEFORE)),
        replace(trial, noise=Noise(2 * np.eye(PLACE_FUNCTIONS), 0.0)),
        replace(trial, s=0.9 * trial.s),
        replace(trial, times=1.1 * trial.times),
        replace(trial, sigma=2 * trial.sigma),
        trial.select_points(np.arange(len(trial.s)) > 0),
    ]
    bases = [DiscrepancyBasis.for_trial(each, growth) for each in changed]
    bases.append(DiscrepancyBasis.for_trial(trial, np.linspace(0.5, 1.0, FRAMES)))
    assert len({id(each) for each in (basis, *bases)}) == 8
    assert DiscrepancyBasis.for_trial(trial, growth) is basis

    before = weakref.ref(bases.pop(0))
    assert before() is None


def test_samples_at_some_points_are_those_of_samples_at_all_points(trial):
    """Samples at the tip alone are those at all points, and agree with their mean."""
    no_shapes = np.zeros((2 * len(trial.s), 0))
    one = Discrepancy.for_trial(trial, np.ones(FRAMES), no_shapes)
    wave = 30 * np.sin(9 * T[trial.frame] + 3 * trial.s) * trial.s / 0.3
    coefficients = one.coefficients(np.repeat(wave, 2)[None])[0]
    grid_point = int(np.searchsorted(DISCREPANCY_SCALES_M, 0.1))
    drawn = {}
    for name, chosen in (("all", np.ones(len(trial.s), bool)), ("tip", trial.is_tip)):
        rng = np.random.default_rng(0)
        drawn[name] = one.sample_posterior(coefficients, grid_point, 50, rng, chosen)
    at_tip = np.repeat(trial.is_tip, 2)
    np.testing.assert_array_equal(drawn["all"][:, at_tip], drawn["tip"])
    mean = one.posterior_mean(coefficients, grid_point)[at_tip]
    assert drawn["tip"].mean(axis=0) == pytest.approx(mean, abs=1.0)
    assert np.ptp(drawn["tip"], axis=0).min() > 0
