"""Noise of a camera: neighbours along the string share a part of it, and so do frames
that follow one another.

Centre-lines are read from images with widths, and trackers smooth. Thousands of
readings that are not independent say less than as many that are: smooth motion, which
is what they are asked for, is then known worse than each reading by itself. So noise is
told in the functions of place of `basis`, made orthonormal in each frame: their
covariance, the same in all frames, and the correlation with the frame before (AR(1)).
Both are told by what residuals have beside smooth motion; restricted likelihood knows
what the smooth part has taken of them (Patterson and Thompson 1971, Biometrika 58,
545).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter
from scipy.sparse import csr_array

from stringcast.stages.inference.basis import PLACE_FUNCTIONS, RANK_TOLERANCE

# correlation with the frame before, as of means over two frames: more is motion
MAX_FRAME_CORRELATION = 0.5


@dataclass(frozen=True)
class Noise:
    """places: covariance of functions of place, over that of white noise, (PLACES,
    PLACES). before: correlation with the frame before.
    """

    place_covariance: np.ndarray
    frame_correlation: float

    @property
    def variance_of_means(self) -> float:
        """Variance of means over many frames, over that of white noise."""
        return float(
            np.trace(self.place_covariance)
            / PLACE_FUNCTIONS
            * (1 + self.frame_correlation)
            / (1 - self.frame_correlation)
        )

    def covariance(self, time: csr_array, place: np.ndarray) -> np.ndarray:
        """Of sums over points of noise times products of functions of time and place,
        (K B, K B).

        time: at each frame (F, B). place: roots of the Gram matrix of functions of
        place in each frame, (F, K, K).
        """
        frames = time.shape[0]
        parts = np.einsum("fij,fb->fijb", place, time.toarray()).reshape(frames, -1)
        together = lfilter([1.0], [1.0, -self.frame_correlation], parts[::-1], axis=0)[
            ::-1
        ]
        together[1:] *= np.sqrt(1 - self.frame_correlation**2)
        root = np.linalg.cholesky(self.place_covariance).T
        mixed = np.einsum(
            "ki,fij->fkj", root, together.reshape(frames, PLACE_FUNCTIONS, -1)
        ).reshape(frames * PLACE_FUNCTIONS, -1)
        return np.asarray(mixed.T @ mixed)


WHITE_NOISE = Noise(np.eye(PLACE_FUNCTIONS), 0.0)


@dataclass(frozen=True)
class NoiseTrack:
    """What is told of a trial's noise. smooth: functions of time (F, B). told:
    residuals in functions of place, orthonormal in each frame, of both coordinates, (F,
    2 PLACES).
    """

    time_splines: np.ndarray
    place_residuals: np.ndarray


def gram_roots(place: np.ndarray, frame: np.ndarray, frames: int) -> np.ndarray:
    """Roots of the Gram matrices of functions of place (n, K) in each frame, (F, K, K)."""
    gram = np.zeros((frames, place.shape[1], place.shape[1]))
    np.add.at(gram, frame, place[:, :, None] * place[:, None, :])
    values, vectors = np.linalg.eigh(gram)
    return np.asarray(
        np.einsum("fik,fk,fjk->fij", vectors, np.sqrt(np.maximum(values, 0.0)), vectors)
    )


def noise_track(
    time: csr_array, place: np.ndarray, frame: np.ndarray, residual: np.ndarray
) -> NoiseTrack:
    """Of residuals (n, 2) at functions of place (n, K) in frames (n,)."""
    frames = time.shape[0]
    sums = np.zeros((frames, place.shape[1], 2))
    np.add.at(sums, frame, place[:, :, None] * residual[:, None, :])
    inverse = np.linalg.pinv(
        gram_roots(place, frame, frames), rcond=np.sqrt(RANK_TOLERANCE), hermitian=True
    )
    return NoiseTrack(time.toarray(), (inverse @ sums).reshape(frames, -1))


def fit_noise_model(tracks: Sequence[NoiseTrack]) -> Noise:
    """The noise of all trials. What a model lacks in a trial looks like more noise,
    never like less, so the quieter half of them is asked (least trimmed: Rousseeuw
    1984, JASA 79, 871).
    """
    quiet = sorted(
        tracks, key=lambda each: _most_likely_noise([each]).variance_of_means
    )
    return _most_likely_noise(quiet[: len(tracks) // 2 + 1])


def _most_likely_noise(tracks: Sequence[NoiseTrack]) -> Noise:
    """That of some trials together. Before they speak it is white, which counts as much
    as PLACES frames.
    """
    found = minimize_scalar(
        lambda before: -_restricted_likelihood(tracks, before)[0],
        bounds=(0.0, MAX_FRAME_CORRELATION),
        method="bounded",
    )
    return Noise(_restricted_likelihood(tracks, found.x)[1], float(found.x))


def _restricted_likelihood(
    tracks: Sequence[NoiseTrack], before: float
) -> tuple[float, np.ndarray]:
    """Restricted log-likelihood of a correlation with the frame before, and the
    covariance that is likeliest then.
    """
    scatter, free, log_volume = (
        PLACE_FUNCTIONS * np.eye(PLACE_FUNCTIONS),
        PLACE_FUNCTIONS,
        0.0,
    )
    for each in tracks:
        smooth, seen = (
            _innovations(each.time_splines, before),
            _innovations(each.place_residuals, before),
        )
        q, r = np.linalg.qr(smooth)
        kept = np.abs(np.diag(r)) > np.sqrt(RANK_TOLERANCE) * np.abs(r).max()
        left = (seen - q[:, kept] @ (q[:, kept].T @ seen)).reshape(
            -1, PLACE_FUNCTIONS, 2
        )
        scatter += np.einsum("fic,fjc->ij", left, left)
        free += 2 * (len(seen) - kept.sum())
        log_volume += (len(seen) - 1) * np.log1p(-(before**2)) + 2 * np.log(
            np.abs(np.diag(r)[kept])
        ).sum()
    places = scatter / free
    return -0.5 * (
        2 * PLACE_FUNCTIONS * log_volume + free * np.linalg.slogdet(places)[1]
    ), places


def _innovations(values: np.ndarray, before: float) -> np.ndarray:
    """What each frame has beyond the one before, of unit size, (F, ...)."""
    new = (values[1:] - before * values[:-1]) / np.sqrt(1 - before**2)
    return np.concatenate([values[:1], new])
