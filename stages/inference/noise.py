"""Correlated noise of a camera.

Noise is correlated along the string and between successive frames, because images have
finite resolution and trackers smooth. Correlated readings determine smooth motion less
well than independent ones. So noise is modelled in the functions of place of `basis`,
made orthonormal in each frame: by their covariance, the same in all frames, and by the
correlation with the previous frame (AR(1)). Both are estimated from residuals after
smooth motion is removed. The restricted likelihood accounts for the noise that is
removed with it.

References
----------
Patterson and Thompson 1971, Biometrika 58, 545 (restricted likelihood).
Rousseeuw 1984, JASA 79, 871 (least trimmed estimation).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.optimize import minimize_scalar

from stringcast.stages.common import mad_sigma
from stringcast.stages.inference.basis import (
    PLACE_FUNCTIONS,
    RANK_TOLERANCE,
    SmoothFunctions,
    knot_spacing,
    place_functions,
    sum_products,
    time_splines,
)
from stringcast.stages.model.model import Model

MAX_FRAME_CORRELATION = 0.5  # that of means over two frames: more is motion
# Degrees of freedom left by the splines, of all: with fewer noise is not estimated
MIN_FREE_SHARE = 0.2


@dataclass(frozen=True)
class Noise:
    """The correlation of noise along the string and in time.

    Parameters
    ----------
    place_covariance
        Covariance in functions of place over that of white noise, (K, K), with K =
        PLACE_FUNCTIONS.
    frame_correlation
        Correlation with the previous frame.
    """

    place_covariance: np.ndarray
    frame_correlation: float

    @property
    def variance_of_means(self) -> float:
        """The variance of means over many frames, relative to white noise."""
        in_time = (1 + self.frame_correlation) / (1 - self.frame_correlation)
        return float(np.trace(self.place_covariance) / PLACE_FUNCTIONS * in_time)

    def filter_in_time(self, values: np.ndarray) -> np.ndarray:
        """Multiply values (F, N) by L' of the AR(1) process (a backward filter)."""
        filtered = values.copy()
        for frame in range(len(values) - 2, -1, -1):
            filtered[frame] += self.frame_correlation * filtered[frame + 1]
        filtered[1:] *= np.sqrt(1 - self.frame_correlation**2)
        return filtered

    def covariance(self, time: np.ndarray, gram_roots: np.ndarray) -> np.ndarray:
        """Compute the covariance (K B, K B) of noise projected on smooth functions.

        A projection is the scalar product of noise and a function over the points. With
        L L' the covariance of the noise, and A the functions, this is (L' A)' (L' A).

        Parameters
        ----------
        time
            Functions of time at each frame, (F, B).
        gram_roots
            Roots of the Gram matrices of functions of place, (F, K, K).
        """
        frames = len(time)
        products = np.einsum("fij,fb->fijb", gram_roots, time)
        filtered = self.filter_in_time(products.reshape(frames, -1))

        # L' of the covariance of functions of place
        place_root = np.linalg.cholesky(self.place_covariance).T
        by_place = filtered.reshape(frames, PLACE_FUNCTIONS, -1)
        mixed = np.einsum("ki,fij->fkj", place_root, by_place)
        rows = mixed.reshape(frames * PLACE_FUNCTIONS, -1)
        return np.asarray(rows.T @ rows)


WHITE_NOISE = Noise(np.eye(PLACE_FUNCTIONS), 0.0)


class MeasuredTrial(Protocol):
    """The part of a prepared trial that its noise and discrepancy depend on.

    It avoids a circular import: the module of prepared trials imports this one.
    """

    @property
    def model(self) -> Model:
        """The model, for the length of its string."""

    @property
    def times(self) -> np.ndarray:
        """The frame times, (F,) [s]."""

    @property
    def frame(self) -> np.ndarray:
        """The frame index of each measured point, (n,)."""

    @property
    def s(self) -> np.ndarray:
        """The arc length of each measured point, (n,) [m]."""

    @property
    def sigma(self) -> np.ndarray:
        """The standard deviation of each measured point, (n,) [m]."""

    @property
    def noise(self) -> Noise:
        """The correlation of the points' noise."""


@dataclass(frozen=True)
class NoiseTrack:
    """The residuals of a trial from which its noise is estimated.

    Parameters
    ----------
    time_splines
        Functions of time, (F, B).
    place_residuals
        Residuals of both coordinates in functions of place that are orthonormal in each
        frame, (F, 2 K).
    """

    time_splines: np.ndarray
    place_residuals: np.ndarray


def gram_roots(gram: np.ndarray) -> np.ndarray:
    """Compute symmetric roots of Gram matrices (F, K, K)."""
    values, vectors = np.linalg.eigh(gram)
    sizes = np.sqrt(np.maximum(values, 0.0))
    return np.asarray(np.einsum("fik,fk,fjk->fij", vectors, sizes, vectors))


def remove_smooth_motion(
    trial: MeasuredTrial, residual: np.ndarray
) -> tuple[np.ndarray, float]:
    """Remove smooth motion from residuals (n, 2) over sigma.

    Returns the rest and a robust estimate of the noise over sigma. If too few degrees
    of freedom would be left, nothing is removed.
    """
    functions = _functions_of_smooth_motion(trial)
    everywhere = np.ones(len(residual), dtype=bool)
    gram_by_frame = functions.gram_by_frame(np.ones(len(residual)))
    gram = sum_products(functions.in_time, functions.in_time, gram_by_frame)
    free_share = 1 - np.linalg.matrix_rank(gram) / len(residual)
    if free_share < MIN_FREE_SHARE:
        return residual, float(mad_sigma(residual))
    sums = functions.sums(residual[None])  # (2, K B)
    factors = np.linalg.lstsq(gram, sums.T, rcond=RANK_TOLERANCE)[0].T
    rest = residual - functions.at_points(factors, everywhere).reshape(-1, 2)
    return rest, float(mad_sigma(rest) / np.sqrt(free_share))


def noise_track(trial: MeasuredTrial, residual: np.ndarray) -> NoiseTrack:
    """Project residuals (n, 2) over sigma onto orthonormal functions of place.

    White noise has unit variance in them.
    """
    functions = _functions_of_smooth_motion(trial)
    frames = len(trial.times)
    sums = np.zeros((frames, PLACE_FUNCTIONS, 2))
    products = functions.in_place[:, :, None] * residual[:, None, :]
    np.add.at(sums, trial.frame, products)
    roots = gram_roots(functions.gram_by_frame(np.ones(len(residual))))
    inverse = np.linalg.pinv(roots, rcond=np.sqrt(RANK_TOLERANCE), hermitian=True)
    return NoiseTrack(functions.in_time, (inverse @ sums).reshape(frames, -1))


def _functions_of_smooth_motion(trial: MeasuredTrial) -> SmoothFunctions:
    """Choose smooth functions that cannot fit all noise of a trial."""
    in_time = time_splines(trial.times, knot_spacing(trial.times))
    in_place = place_functions(trial.s, trial.model.string.length)
    return SmoothFunctions(in_time, in_place, trial.frame)


def fit_noise_model(tracks: Sequence[NoiseTrack]) -> Noise:
    """Estimate the noise of all trials from the quieter half.

    Misfit of a model can only increase the apparent noise.
    """
    levels = [_most_likely_noise([track]).variance_of_means for track in tracks]
    order = np.argsort(levels, kind="stable")
    quiet = [tracks[k] for k in order[: len(tracks) // 2 + 1]]
    return _most_likely_noise(quiet)


def _most_likely_noise(tracks: Sequence[NoiseTrack]) -> Noise:
    """Maximise the joint restricted likelihood of some trials.

    The prior is white noise, with the weight of PLACE_FUNCTIONS frames.
    """

    def cost(frame_correlation: float) -> float:
        return -_restricted_likelihood(tracks, frame_correlation)[0]

    bounds = (0.0, MAX_FRAME_CORRELATION)
    best = minimize_scalar(cost, bounds=bounds, method="bounded").x
    _, place_covariance = _restricted_likelihood(tracks, best)
    return Noise(place_covariance, float(best))


def _restricted_likelihood(
    tracks: Sequence[NoiseTrack],
    frame_correlation: float,
) -> tuple[float, np.ndarray]:
    """Compute the restricted log-likelihood of a correlation with the previous frame.

    Returns it and the most likely covariance in functions of place, (K, K).
    """
    scatter = PLACE_FUNCTIONS * np.eye(PLACE_FUNCTIONS)
    degrees = PLACE_FUNCTIONS
    log_volume = 0.0
    for track in tracks:
        smooth = _innovations(track.time_splines, frame_correlation)
        noisy = _innovations(track.place_residuals, frame_correlation)
        frames = len(noisy)

        # Subtract the smooth motion; its splines may be linearly dependent
        q, r = np.linalg.qr(smooth)
        diagonal = np.abs(np.diag(r))
        kept = diagonal > np.sqrt(RANK_TOLERANCE) * np.abs(r).max()
        basis = q[:, kept]
        residual = noisy - basis @ (basis.T @ noisy)

        by_place = residual.reshape(-1, PLACE_FUNCTIONS, 2)
        scatter += np.einsum("fic,fjc->ij", by_place, by_place)
        degrees += 2 * (frames - kept.sum())
        log_innovations = (frames - 1) * np.log1p(-(frame_correlation**2))
        log_smooth = 2 * np.log(diagonal[kept]).sum()
        log_volume += log_innovations + log_smooth
    covariance = scatter / degrees
    log_determinant = np.linalg.slogdet(covariance)[1]
    twice = 2 * PLACE_FUNCTIONS * log_volume + degrees * log_determinant
    return -0.5 * twice, covariance


def _innovations(values: np.ndarray, frame_correlation: float) -> np.ndarray:
    """Compute the innovations of an AR(1) process at unit variance, (F, ...)."""
    added = values[1:] - frame_correlation * values[:-1]
    scaled = added / np.sqrt(1 - frame_correlation**2)
    return np.concatenate([values[:1], scaled])
