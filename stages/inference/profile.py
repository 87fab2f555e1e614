"""Intervals of parameters from the profile likelihood, where it is not normal.

Laplace's approximation assumes a normal posterior. But two parameters may compensate
each other along a curve, such as the height and the tilt of a plane that a string
touches in one place. So a parameter is fixed at growing distances from its best value
while the others are fitted, until the log-likelihood has fallen as far as that of a
normal posterior at the end of its interval.

References
----------
MINOS: James and Roos 1975, Comput. Phys. Commun. 10, 343.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from stringcast.stages.inference.huber import huber_loss
from stringcast.stages.inference.solver import Problem, fit_least_squares

# A likelihood is taken as normal if its fall is within this factor of a normal one's
NORMAL_FALL_RATIO = 2.0
MAX_DOUBLINGS = 2  # of the distance at which an exponent is fixed
FIT_ITERATIONS = 4  # of the other exponents, from their linear extrapolation
LEAST_PRECISION = 1e-9  # of an exponent that data do not determine


def profile_reaches(
    problem: Problem,
    chi: np.ndarray,
    precision: np.ndarray,
    indices: Sequence[int],
    half_width: float,
) -> np.ndarray:
    """Compute how far intervals reach below and above the best exponents, (I, 2).

    They reach at least as far as those of a normal posterior.

    Parameters
    ----------
    problem
        The likelihood as a least-squares problem.
    chi
        The best exponents, (P,).
    precision
        Precision of the normal posterior, (P, P).
    indices
        Indices of the I exponents.
    half_width
        Half width of the interval, in standard deviations.
    """
    covariance = np.linalg.inv(precision + LEAST_PRECISION * np.eye(len(chi)))
    best_loss = huber_loss(problem.residuals(chi[None]), problem.limit)[0]

    # The likelihood at both ends of the normal interval of each exponent
    index = np.repeat(np.asarray(indices, dtype=int), 2)
    sign = np.tile([-1.0, 1.0], len(indices))
    deviation = np.sqrt(covariance[index, index])
    step = (sign * half_width / deviation)[:, None] * covariance[index]
    ends = np.clip(chi + step, 0.0, 1.0)
    moved = (ends - chi)[range(len(index)), index]
    normal_fall = 0.5 * (moved / deviation) ** 2
    fall = _log_likelihood_falls(problem, problem.residuals(ends), best_loss)
    is_normal = (fall >= normal_fall / NORMAL_FALL_RATIO) & (
        fall <= normal_fall * NORMAL_FALL_RATIO
    )

    # Follow the profile where the likelihood does not fall as a normal one
    profiles = {}
    for number in np.flatnonzero(~is_normal & (moved != 0)).tolist():
        profiles[number] = _Profile(int(index[number]), chi, ends[number], half_width)
    for _ in range(1 + MAX_DOUBLINGS):
        going = [profile for profile in profiles.values() if not profile.is_ended]
        if not going:
            break
        starts = np.array([profile.start for profile in going])
        is_fixed = np.arange(len(chi)) == [[profile.index] for profile in going]
        runs = fit_least_squares(problem, starts, FIT_ITERATIONS, is_fixed=is_fixed)
        falls = _log_likelihood_falls(problem, runs.residual, best_loss)
        for profile, chi_now, fall_now in zip(going, runs.chi, falls, strict=True):
            profile.advance(chi_now, fall_now)

    reach = half_width * deviation
    for number, profile in profiles.items():
        reach[number] = max(reach[number], profile.reach)
    return np.asarray(reach.reshape(-1, 2))


def _log_likelihood_falls(
    problem: Problem, residual: np.ndarray, best_loss: float
) -> np.ndarray:
    """Compute the best log-likelihood minus those of residuals (R, N)."""
    loss = huber_loss(residual, problem.limit)
    return np.asarray(0.5 * residual.shape[1] * (loss - best_loss))


@dataclass
class _Profile:
    """A side of an exponent's profile, followed outwards.

    Parameters
    ----------
    index
        Index of the fixed exponent.
    best
        The best exponents, (P,).
    start
        Exponents from which the next fit starts, (P,).
    half_width
        Where to stop, in standard deviations.
    """

    index: int
    best: np.ndarray
    start: np.ndarray
    half_width: float
    reach: float = 0.0  # distance of the exponent from its best value
    is_ended: bool = False
    before: np.ndarray = field(init=False)
    deviation_before: float = 0.0  # root of twice the fall: standard deviations

    def __post_init__(self) -> None:
        self.before = self.best

    def advance(self, chi: np.ndarray, fall: float) -> None:
        """Double the distance, or stop if the likelihood has fallen enough.

        chi: the fixed exponent and the best others, (P,).
        """
        step = chi - self.before
        deviation = float(np.sqrt(2 * max(fall, 0.0)))
        distance = abs(chi[self.index] - self.best[self.index])
        if deviation >= self.half_width:
            rise = deviation - self.deviation_before
            share = (self.half_width - self.deviation_before) / rise
            self.reach += share * abs(step[self.index])
            self.is_ended = True
            return
        self.reach = distance
        ratio = distance / abs(step[self.index])
        self.start = np.clip(chi + ratio * step, 0.0, 1.0)
        self.is_ended = bool(self.start[self.index] == chi[self.index])  # at a bound
        self.before = chi
        self.deviation_before = deviation
