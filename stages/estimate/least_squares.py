"""Least squares on the centre-line, which also says how certain each parameter is.

Gauss-Newton with Levenberg's damping in chi, from several starts side by side; the
Jacobian is a finite difference whose candidates run in one batch. A string that is swung
forgets where it came from, so the whole trial has many local minima: its beginning is
fitted first, and the horizon widens as the fit improves. Outliers count less (Huber).

Residuals of neighbouring points and frames are not independent, so the covariance
is the sandwich estimate over blocks of time (White 1980; Cameron and Miller 2015).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.stats import t as student

from data.artifacts import Estimate, Observation
from stages.estimate.forward import Case
from stages.estimate.matching import Matching, matching_rate, targets
from stages.estimate.result import EDGE, Interval, Search, estimate_of, start_chi, values_of, words
from stages.model.arm import Arm
from stages.model.camera import Camera
from stages.model.string import String

STEP = 1e-4  # of chi, for the central difference
HUBER = 2.0  # robust scales beyond which a residual counts less
BLOCK = 0.05  # [s] of time taken as one independent piece
WIDE = 0.3  # an interval this wide in chi determines nothing
HORIZONS = (0.35, 0.5, 0.65, 0.8, 1.0, 1.0, 1.0, 1.0)  # shares of the time, fitted one after the other
STUBBORN = 1e-9  # added to the normal matrix, so that flat directions stay put
DAMPINGS = np.array([1e-7, 1e-4, 1e-2, 1.0, 100.0])


def estimate(
    string: String,
    arm: Arm,
    camera: Camera,
    observations: Sequence[Observation],
    previous: Estimate | None,
    *,
    seed: int,
    manipulation: Annotated[int, Field(ge=1)],
    starts: Annotated[int, Field(ge=1)],
    screening: Annotated[int, Field(ge=1)],
    iterations: Annotated[int, Field(ge=1)],
    matching: Matching,
    progress: Callable[[float], object] = lambda share: None,
) -> Estimate:
    """Parameters of least squared distance to the measured points, with 95 % intervals.

    screening: random candidates from which the best `starts` are refined, beside the
    previous estimate. iterations: Gauss-Newton steps of each. `manipulation` plays no part.
    """
    goals = targets(string, arm, camera, observations, matching)
    cases = [goal.case for goal in goals]
    before = start_chi(string.parameters, previous)
    drawn = np.random.default_rng([seed, manipulation]).uniform(0, 1, (screening, len(before)))
    screened = np.concatenate([before[None], drawn])
    order = np.argsort(_costs([ready.until(HORIZONS[0]) for ready in cases], screened))
    chi = screened[order[:starts]]
    for number in range(iterations):
        share = HORIZONS[number * len(HORIZONS) // iterations]
        chi = _improved([ready.until(share) for ready in cases], chi)
        progress((number + 1) / iterations)
    best = chi[int(np.argmin(_costs(cases, chi)))]
    tried = np.concatenate([screened, chi])
    search = Search("least squares", tried, matching_rate(goals, values_of(string.parameters, tried)))
    return estimate_of(goals, before, best, search, interval(cases, best))


def interval(cases: Sequence[Case], chi: np.ndarray) -> Interval:
    """95 % intervals about the solution chi (P,), and what the data cannot determine."""
    residual, jacobian = _linear(cases, chi[None])
    weight = _huber(residual[0])
    normal = np.einsum("np,n,nq->pq", jacobian[0], weight, jacobian[0])
    gradient = jacobian[0] * (weight * residual[0])[:, None]
    sums = np.stack([gradient[block].sum(axis=0) for block in _blocks(cases)])
    spread = len(sums) / max(len(sums) - len(chi), 1) * sums.T @ sums
    inverse = np.linalg.pinv(normal + STUBBORN * np.eye(len(chi)) * np.trace(normal), hermitian=True)
    deviation = np.sqrt(np.maximum(np.diag(inverse @ spread @ inverse), 0))
    reach = student.ppf(0.975, max(len(sums) - len(chi), 1)) * deviation
    low, high = np.clip(chi - reach, 0, 1), np.clip(chi + reach, 0, 1)
    flat = np.diag(normal) < 1e-9 * np.trace(normal)
    determined = (high - low < WIDE) & (chi > EDGE) & (chi < 1 - EDGE) & ~flat
    return Interval(low, high, determined, words(cases[0].string.parameters, determined))


def _improved(cases: Sequence[Case], chi: np.ndarray) -> np.ndarray:
    """One damped Gauss-Newton step of every start (K, P): the best of several dampings, or none."""
    residual, jacobian = _linear(cases, chi)
    trials = [chi]
    for damping in DAMPINGS:
        step = np.zeros_like(chi)
        for k in range(len(chi)):
            weight = _huber(residual[k])
            normal = np.einsum("np,n,nq->pq", jacobian[k], weight, jacobian[k])
            right = jacobian[k].T @ (weight * residual[k])
            level = damping * np.diag(normal) + STUBBORN * np.trace(normal)
            step[k] = -np.linalg.solve(normal + np.diag(level), right)
        trials.append(np.clip(chi + np.clip(step, -0.2, 0.2), 0, 1))
    stacked = np.stack(trials)
    costs = _costs(cases, stacked.reshape(-1, chi.shape[1])).reshape(len(trials), -1)
    return stacked[np.argmin(costs, axis=0), np.arange(len(chi))]


def _linear(cases: Sequence[Case], chi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residuals (K, N) and their slopes with chi (K, N, P), all candidates in one batch."""
    count, size = chi.shape
    # Inside the range on both sides: a parameter on its bound is differenced a little within it.
    middle = np.clip(chi, STEP, 1 - STEP)
    steps = STEP * np.concatenate([np.eye(size), -np.eye(size)])
    moved = np.concatenate([chi[:, None], middle[:, None] + steps], axis=1)
    residual = _residuals(cases, moved.reshape(-1, size)).reshape(count, 2 * size + 1, -1)
    slope = (residual[:, 1 : size + 1] - residual[:, size + 1 :]) / (2 * STEP)
    return residual[:, 0], slope.transpose(0, 2, 1)


def _residuals(cases: Sequence[Case], chi: np.ndarray) -> np.ndarray:
    """Simulated less measured, over sigma, (C, N); huge where a run was rejected."""
    values = values_of(cases[0].string.parameters, chi)
    parts = []
    for ready in cases:
        part = np.empty((len(values), 2 * len(ready.points)))
        for some, motion in ready.simulate(values):
            difference = (ready.at_measured(motion) - ready.points) / ready.sigma[None, :, None]
            part[some] = difference.reshape(len(difference), -1)
        parts.append(part)
    return np.nan_to_num(np.concatenate(parts, axis=1), nan=1e6)


def _costs(cases: Sequence[Case], chi: np.ndarray) -> np.ndarray:
    """Root mean square residual of each candidate, chunk by chunk, (C,)."""
    chunks = np.array_split(chi, max(len(chi) // 64, 1))
    return np.concatenate([np.sqrt(np.mean(_residuals(cases, some) ** 2, axis=1)) for some in chunks])


def _huber(residual: np.ndarray) -> np.ndarray:
    """Weights of residuals (N,): 1 within HUBER robust scales, less beyond."""
    scale = 1.4826 * np.median(np.abs(residual)) + 1e-12
    return np.minimum(1.0, HUBER * scale / np.maximum(np.abs(residual), 1e-300))


def _blocks(cases: Sequence[Case]) -> list[np.ndarray]:
    """Indices of the residuals of each block of time of each trial."""
    blocks, first = [], 0
    for ready in cases:
        number = np.floor(ready.times[ready.frame] / BLOCK).astype(int).repeat(2)
        blocks += [first + np.flatnonzero(number == value) for value in np.unique(number)]
        first += len(number)
    return blocks
