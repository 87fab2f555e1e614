"""What a model lacks in a trial, as a smooth random displacement of the string (Kennedy
and O'Hagan 2001).

    simulated - measured = U a + s d + e,        d ~ GP,   a ~ N(0, 1),   e: noise

d is zero at the grasp, smooth along the string (squared exponential, 0.35 L) and in
time (Matern 3/2), and grows over the trial as any small change of the model's
parameters does. Its size s [m], root mean square at the tip, is unknown for every
trial: half-Cauchy, on a grid. U are the modes of the trial's beginning.

A trial is told by its coefficients in a basis of smooth functions of time and place
(Higdon et al. 2008, JASA 103, 570), turned such that noise (`noise`) is white and the
discrepancy diagonal: a size s then costs nothing to try. What is left beside them is
noise, whose size it tells.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from scipy.linalg import eigh
from scipy.sparse import csr_array
from scipy.special import logsumexp

from stringcast.stages.common import mad_sigma, rms
from stringcast.stages.inference.basis import (
    KNOT_SPACING_S,
    RANK_TOLERANCE,
    knot_spacing,
    nystrom_root,
    place_functions,
    tensor_products,
    time_nodes,
    time_splines,
)
from stringcast.stages.inference.noise import NoiseTrack, gram_roots, noise_track
from stringcast.stages.inference.whitening import LowRankWhitening

if TYPE_CHECKING:
    from stringcast.stages.inference.prepared_trial import PreparedTrial

# [s] of the Matern kernel: in the middle of 0.05 to 0.12, which suited nine fits of
# strings of 0.3 m
MATERN_TIME_S = 0.08
# [m] of s: each 1.56 times the last; no string is as far
DISCREPANCY_SCALES_M = np.concatenate([[0.0], np.geomspace(5e-5, 2.0, 25)])
MEDIAN_SCALE_M = 5e-4  # [m] of s: half of all trials have less (half-Cauchy)
# of all points: with fewer beside what splines tell, they do not tell the noise
MIN_FREE_SHARE = 0.2


@dataclass(frozen=True)
class Discrepancy:
    """Of one trial, in M coefficients for each coordinate.

    splines: (n, B) at the measured points. turn: (M, B) from sums over points, of
    residuals over sigma times splines, to coefficients; unturn: (B, M) back to splines.
    variance: (M,) of the discrepancy for s = 1 m. nuisance: U in coefficients, (2 M,
    m); modes: as it is, (2 n, m).
    """

    splines: csr_array
    to_coefficients: np.ndarray
    to_splines: np.ndarray
    variance: np.ndarray
    nuisance_coefficients: np.ndarray
    nuisance_shapes: np.ndarray
    scale: ClassVar[float] = 1.0  # of noise, in the points' own sigma

    @classmethod
    def for_trial(
        cls, trial: PreparedTrial, growth: np.ndarray, nuisance: np.ndarray
    ) -> Discrepancy:
        """growth: of d at each frame, (F,). nuisance: U over sigma, (2 n, m)."""
        time, place = (
            time_splines(trial.times),
            place_functions(trial.s, trial.model.string.length),
        )
        splines = tensor_products(time[trial.frame], place)
        spread = trial.noise.covariance(
            time, gram_roots(place, trial.frame, len(trial.times))
        )
        values, vectors = eigh(spread)
        kept = values > RANK_TOLERANCE * values[-1]
        # of sums over points to coefficients of what splines tell, in which noise is
        # white
        told = (vectors[:, kept] / np.sqrt(values[kept])).T
        smooth = told @ (splines.T @ _kernel_root(trial, growth))
        variance, turn = eigh(smooth @ smooth.T)
        of_splines = told @ (splines.T @ splines).toarray() @ vectors[:, kept]
        unturn = vectors[:, kept] @ np.linalg.solve(of_splines, turn)
        none = (np.zeros((2 * len(variance), 0)), np.zeros((2 * len(trial.s), 0)))
        return cls(
            splines, turn.T @ told, unturn, np.maximum(variance, 0.0), *none
        ).with_nuisance(nuisance)

    def coefficients(self, residual: np.ndarray) -> np.ndarray:
        """(C, 2 M) of residuals over sigma (C, 2 n)."""
        count, points, number = (
            len(residual),
            self.splines.shape[0],
            len(self.to_coefficients),
        )
        by_point = (
            residual.reshape(count, points, 2)
            .transpose(1, 0, 2)
            .reshape(points, 2 * count)
        )
        found = self.to_coefficients @ (self.splines.T @ by_point)
        return np.asarray(
            found.reshape(number, count, 2)
            .transpose(1, 0, 2)
            .reshape(count, 2 * number)
        )

    def with_nuisance(self, modes: np.ndarray) -> Discrepancy:
        """With more nuisance: U over sigma (2 n, m)."""
        nuisance = np.hstack([self.nuisance_coefficients, self.coefficients(modes.T).T])
        return replace(
            self,
            nuisance_coefficients=nuisance,
            nuisance_shapes=np.hstack([self.nuisance_shapes, modes]),
        )

    def replace_leading_nuisance(self, modes: np.ndarray, count: int) -> Discrepancy:
        """With other nuisance, U over sigma (2 n, m), in the place of its first so many
        columns.
        """
        nuisance = np.hstack(
            [self.coefficients(modes.T).T, self.nuisance_coefficients[:, count:]]
        )
        return replace(
            self,
            nuisance_coefficients=nuisance,
            nuisance_shapes=np.hstack([modes, self.nuisance_shapes[:, count:]]),
        )

    def whiten(self, residual: np.ndarray, size: int) -> np.ndarray:
        """Compute white coefficients (C, 2 M) of residuals over sigma (C, 2 n), at a
        number of SIZES.
        """
        return self.whiten_coefficients(self.coefficients(residual), size)

    def whiten_coefficients(self, coefficients: np.ndarray, size: int) -> np.ndarray:
        """V(s)^(-1/2) of coefficients (C, 2 M), at a number of SIZES."""
        deviation, rank = self._whitening_by_scale[size]
        return rank(coefficients / deviation)

    def log_likelihood_by_scale(self, coefficients: np.ndarray) -> np.ndarray:
        """Of coefficients (C, 2 M) at all SIZES, (C, S)."""
        found = []
        for deviation, rank in self._whitening_by_scale:
            square = np.sum(rank(coefficients / deviation) ** 2, axis=1)
            found.append(
                -0.5 * square
                - np.log(deviation).sum()
                + np.log1p(-rank.removed_share).sum()
            )
        return np.stack(found, axis=1)

    def posterior_mean(self, coefficients: np.ndarray, size: int) -> np.ndarray:
        """The discrepancy over sigma (2 n,) that coefficients (2 M,) leave most likely."""
        variance = np.repeat(DISCREPANCY_SCALES_M[size] ** 2 * self.variance, 2)
        known = coefficients - self.nuisance_coefficients @ self._nuisance_amplitudes(
            coefficients, size
        )
        told = (known * variance / (1.0 + variance)).reshape(-1, 2)
        return np.asarray((self.splines @ (self.to_splines @ told)).ravel())

    def nuisance_mean(self, coefficients: np.ndarray, size: int) -> np.ndarray:
        """What another beginning most likely explains of coefficients (2 M,), over
        sigma, (2 n,).
        """
        return np.asarray(
            self.nuisance_shapes @ self._nuisance_amplitudes(coefficients, size)
        )

    def _nuisance_amplitudes(self, coefficients: np.ndarray, size: int) -> np.ndarray:
        deviation, _ = self._whitening_by_scale[size]
        root = self.nuisance_coefficients / deviation[:, None]
        return np.asarray(
            np.linalg.solve(
                np.eye(root.shape[1]) + root.T @ root,
                root.T @ (coefficients / deviation),
            )
        )

    def sample_posterior(
        self, coefficients: np.ndarray, size: int, count: int, rng: np.random.Generator
    ) -> np.ndarray:
        """Discrepancies over sigma (count, 2 n) as likely as coefficients (2 M,) leave
        them.
        """
        variance = np.repeat(DISCREPANCY_SCALES_M[size] ** 2 * self.variance, 2)
        scatter = rng.standard_normal((count, len(variance))) * np.sqrt(
            variance / (1.0 + variance)
        )
        told = scatter.reshape(count, -1, 2).transpose(1, 0, 2).reshape(-1, 2 * count)
        off = (
            (self.splines @ (self.to_splines @ told))
            .reshape(-1, count, 2)
            .transpose(1, 0, 2)
            .reshape(count, -1)
        )
        return np.asarray(self.posterior_mean(coefficients, size) + off)

    @cached_property
    def _whitening_by_scale(self) -> list[tuple[np.ndarray, LowRankWhitening]]:
        """Deviations (2 M,) of coefficients without nuisance, and what whitens them
        then, at each of SIZES.
        """
        deviations = [
            np.repeat(np.sqrt(1.0 + size**2 * self.variance), 2)
            for size in DISCREPANCY_SCALES_M
        ]
        return [
            (
                each,
                LowRankWhitening.from_columns(
                    self.nuisance_coefficients / each[:, None]
                ),
            )
            for each in deviations
        ]


def remove_smooth_motion(
    trial: PreparedTrial, residual: np.ndarray
) -> tuple[np.ndarray, float]:
    """What residuals (n, 2) over sigma have beside smooth motion, and the noise over
    sigma that it tells, robustly; all of them where there are too few to tell.
    """
    place = place_functions(trial.s, trial.model.string.length)
    splines = tensor_products(
        time_splines(trial.times, knot_spacing(trial.times))[trial.frame], place
    )
    gram = (splines.T @ splines).toarray()
    free = 1 - np.linalg.matrix_rank(gram) / len(residual)
    if free < MIN_FREE_SHARE:
        return residual, float(mad_sigma(residual))
    beside = (
        residual
        - splines @ np.linalg.lstsq(gram, splines.T @ residual, rcond=RANK_TOLERANCE)[0]
    )
    return beside, float(mad_sigma(beside) / np.sqrt(free))


def noise_track_of_trial(trial: PreparedTrial, residual: np.ndarray) -> NoiseTrack:
    """What residuals (n, 2) over their noise tell of that."""
    time = time_splines(trial.times, knot_spacing(trial.times))
    return noise_track(
        time, place_functions(trial.s, trial.model.string.length), trial.frame, residual
    )


def log_scale_prior() -> np.ndarray:
    """Of SIZES, half-Cauchy: what lies between the middles of neighbours, (S,)."""
    edges = np.concatenate(
        [
            [0.0, DISCREPANCY_SCALES_M[1] / 2],
            np.sqrt(DISCREPANCY_SCALES_M[1:-1] * DISCREPANCY_SCALES_M[2:]),
            [np.inf],
        ]
    )
    return np.asarray(np.log(np.diff(2 / np.pi * np.arctan(edges / MEDIAN_SCALE_M))))


def marginal_log_likelihood(log_likelihoods: np.ndarray) -> np.ndarray:
    """Log-likelihood whatever s is, of (..., S)."""
    return np.asarray(logsumexp(log_likelihoods + log_scale_prior(), axis=-1))


def best_scale_index(log_likelihoods: np.ndarray) -> np.ndarray:
    """Number of the likeliest of SIZES, of (..., S)."""
    return np.asarray(np.argmax(log_likelihoods + log_scale_prior(), axis=-1))


def _kernel_root(trial: PreparedTrial, growth: np.ndarray) -> np.ndarray:
    """Columns (n, K) whose products are the covariance of the discrepancy, of unit mean
    square at the tip.
    """
    at = time_nodes(trial.times, KNOT_SPACING_S)
    memory = max(MATERN_TIME_S, 2 * (at[1] - at[0]))
    rate = np.sqrt(3) / memory  # of a Matern kernel of order 3/2
    time = nystrom_root(
        trial.times, at, lambda gap: (1 + rate * gap) * np.exp(-rate * gap)
    )[trial.frame]
    # there is none where a trial cannot be simulated
    typical = max(rms(growth), np.finfo(float).tiny)
    grown = (growth / typical)[trial.frame] / trial.sigma
    place = place_functions(trial.s, trial.model.string.length)
    return np.asarray(
        ((grown[:, None] * time)[:, :, None] * place[:, None, :]).reshape(
            len(trial.s), -1
        )
    )
