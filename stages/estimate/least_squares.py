"""Least squares on the centre-line, which also says how certain each parameter is.

Gauss-Newton with Levenberg's damping in chi, from several starts side by side; the
Jacobian is a finite difference whose candidates run in one batch. A string that is swung
forgets where it came from, so the whole trial has many local minima: its beginning is
fitted first, from many starts, and the horizon widens while the better half of them goes
on. The best is then brought to its minimum by scipy's trust region. Outliers count less
(Huber), in every step and in what it is judged by.

Residuals of neighbouring points and frames are not independent, so the covariance is the
sandwich estimate over blocks of time (White 1980; Cameron and Miller 2015). Before the data
speak, every value in the range counts as equally likely: that keeps an interval about what
no data touches, alone or in combination, as wide as the range.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.optimize import least_squares as trust_region
from scipy.special import stdtrit

from stringcast.data.artifacts import Estimate, Observation
from stringcast.stages.common import Progress, mad_sigma
from stringcast.stages.estimate.forward import Case
from stringcast.stages.estimate.matching import Matching, Target, matching_rate, targets
from stringcast.stages.estimate.result import EDGE, Interval, Search, estimate_of, start_chi, tied, values_of, words
from stringcast.stages.estimate.settle import settled
from stringcast.stages.model.model import Model

STEP = 1e-4  # of chi, for the central difference
HUBER = 2.0  # robust scales beyond which a residual counts less
BLOCK = 0.05  # [s] of time taken as one independent piece
WIDE = 0.3  # an interval this wide in chi determines nothing
HORIZONS = (0.2, 0.35, 0.5, 0.65, 0.8, 1.0, 1.0, 1.0)  # shares of the time, fitted one after the other
FINALISTS = 6  # starts that are followed to the end; after each horizon the better half goes on
MISFIT = 1.5  # times the points' own uncertainty: a residual beyond that is more than noise
STUBBORN = 1e-9  # added to the normal matrix, so that flat directions stay put
PRIOR = 12.0  # one over the variance of a chi that may lie anywhere in [0, 1]
TURNS = 3  # in which initial states and parameters are fitted, where trials begin moving
POLISH = 100  # steps of the trust region at most; it mostly takes fewer than 20
DRAWS = 400  # strings that stand for all that are possible
DAMPINGS = np.array([1e-7, 1e-4, 1e-2, 1.0, 100.0])


def estimate(
    model: Model,
    observations: Sequence[Observation],
    previous: Estimate | None,
    *,
    seed: int,
    manipulation: Annotated[int, Field(ge=1)],
    starts: Annotated[int, Field(ge=1)],
    screening: Annotated[int, Field(ge=1)],
    iterations: Annotated[int, Field(ge=1)],
    matching: Matching,
    progress: Progress = lambda share: None,
) -> Estimate:
    """Parameters of least squared distance to the measured points, with 95 % intervals.

    screening: random candidates from which the best `starts` are refined, beside the previous
    estimate; in them, effects beyond the paper's are as they are known. iterations: Gauss-Newton
    steps in all. `manipulation` plays no part.
    The intervals are of the model's parameters under noise; what the model itself lacks they
    cannot cover, and the sentence says so where the residual is more than noise.
    """
    goals = targets(model, observations, matching)
    cases = [goal.case for goal in goals]
    before = start_chi(model.parameters, previous)
    drawn = np.random.default_rng([seed, manipulation]).uniform(0, 1, (screening, len(before)))
    told = _told(model)
    drawn[:, told] = before[told]
    screened = np.concatenate([before[None], drawn])
    order = np.argsort(_costs([ready.until(HORIZONS[0]) for ready in cases], screened, np.inf))
    chi = screened[order[:starts]]
    for number, steps in enumerate(np.array_split(np.arange(iterations), len(HORIZONS))):
        chi = _advanced([ready.until(HORIZONS[number]) for ready in cases], chi, len(steps))
        progress((number + 1) / len(HORIZONS))
    limit = _limit(_residuals(cases, chi)).min()
    best = _polished(cases, chi[int(np.argmin(_costs(cases, chi, limit)))])
    if any(ready.initial is not None for ready in cases):
        cases, best = _settled(cases, best)
        goals = [replace(goal, case=ready) for goal, ready in zip(goals, cases, strict=True)]
    tried = np.concatenate([screened, chi, best[None]])
    search = Search("least squares", tried, matching_rate(goals, values_of(model.parameters, tried)))
    return estimate_of(goals, before, best, search, interval(cases, best), possible(goals, best, seed))


def _told(model: Model) -> np.ndarray:
    """Places of what is known of effects beyond the paper's: it is not sought all over its range, where a dry friction,
    say, asks for a hundred times as many steps, but refined."""
    return np.array([i for i, name in enumerate(model.names) if "." in name and name in model.known], dtype=int)


def _advanced(cases: Sequence[Case], chi: np.ndarray, steps: int) -> np.ndarray:
    """Some steps of every start (K, P), and the better half of them, best first."""
    for _ in range(steps):
        chi = _improved(cases, chi)
    kept = max(len(chi) // 2, FINALISTS)
    return chi[np.argsort(_costs(cases, chi, np.inf))[:kept]]


def _settled(cases: Sequence[Case], chi: np.ndarray) -> tuple[list[Case], np.ndarray]:
    """Cases whose initial states suit the parameters, and the minimum for these, found in turns."""
    settling = list(cases)
    for _ in range(TURNS):
        values = values_of(cases[0].model.parameters, chi[None])[0]
        settling = [settled(ready, values) for ready in settling]
        chi = _polished(settling, chi)
    return settling, chi


def interval(cases: Sequence[Case], chi: np.ndarray) -> Interval:
    """95 % intervals about the solution chi (P,), and what the data cannot determine."""
    parameters = cases[0].model.parameters
    covariance, blocks = _covariance(cases, chi)
    deviation = np.sqrt(np.diag(covariance))
    reach = stdtrit(max(blocks - len(chi), 1), 0.975) * deviation
    low, high = np.clip(chi - reach, 0, 1), np.clip(chi + reach, 0, 1)
    determined = (high - low < WIDE) & (chi > EDGE) & (chi < 1 - EDGE)
    sentence = words(parameters, determined, "This data determines every parameter.")
    together = tied(parameters, determined, covariance / np.outer(deviation, deviation))
    return Interval(low, high, determined, sentence + together + _misfit(cases, chi))


def possible(goals: Sequence[Target], chi: np.ndarray, seed: int) -> np.ndarray:
    """Strings that the trials leave possible about a solution chi (P,), whichever way it was found: (DRAWS, P).

    Normal, with the covariance of least squares there; what would leave its range stops at its end.
    """
    covariance, _ = _covariance([goal.case for goal in goals], chi)
    return np.clip(np.random.default_rng([seed, DRAWS]).multivariate_normal(chi, covariance, DRAWS), 0, 1)


def _misfit(cases: Sequence[Case], chi: np.ndarray) -> str:
    """What to say where the residual is more than the points' own uncertainty, where that is known."""
    size = float(_limit(_residuals(cases, chi[None])[0])) / HUBER
    if size < MISFIT:
        return ""
    return (
        f" The residual is {size:.1f} times what the points' uncertainty explains: the model lacks something, "
        "and the intervals do not cover that."
    )


def _covariance(cases: Sequence[Case], chi: np.ndarray) -> tuple[np.ndarray, int]:
    """Sandwich covariance of the solution chi (P,), (P, P), and the number of blocks it rests on."""
    residual, jacobian = (each[0] for each in _linear(cases, chi[None]))
    limit = _limit(residual)
    weight, scale = _huber(residual, limit), limit / HUBER
    prior = PRIOR * np.eye(len(chi))
    bread = np.linalg.inv(jacobian.T @ (weight[:, None] * jacobian) / scale**2 + prior)
    gradient = jacobian * (weight * residual)[:, None] / scale**2
    sums = np.stack([gradient[block].sum(axis=0) for block in _blocks(cases)])
    few = len(sums) / max(len(sums) - len(chi), 1)
    return bread @ (few * sums.T @ sums + prior) @ bread, len(sums)


def _improved(cases: Sequence[Case], chi: np.ndarray) -> np.ndarray:
    """One damped Gauss-Newton step of every start (K, P): the best of several dampings, or none."""
    residual, jacobian = _linear(cases, chi)
    limit = _limit(residual)
    weight = _huber(residual, limit)
    gradient = np.einsum("knp,kn,kn->kp", jacobian, weight, residual)
    held = ((chi <= 0) & (gradient > 0)) | ((chi >= 1) & (gradient < 0))  # at a bound and pushed against it
    jacobian, gradient = np.where(held[:, None], 0.0, jacobian), np.where(held, 0.0, gradient)
    normal = np.einsum("knp,kn,knq->kpq", jacobian, weight, jacobian)
    trials = np.stack([chi, *(np.clip(chi + _step(normal, gradient, damping), 0, 1) for damping in DAMPINGS)])
    costs = _costs(cases, trials.reshape(-1, chi.shape[1]), np.tile(limit, len(trials))).reshape(len(trials), -1)
    return trials[np.argmin(costs, axis=0), np.arange(len(chi))]


def _step(normal: np.ndarray, gradient: np.ndarray, damping: float) -> np.ndarray:
    """Levenberg's step of each start (K, P), a fifth of the range at most. normal: (K, P, P)."""
    diagonal = np.diagonal(normal, axis1=1, axis2=2)
    level = damping * diagonal + STUBBORN * diagonal.sum(axis=1, keepdims=True) + np.finfo(float).tiny
    damped = normal + level[:, :, None] * np.eye(gradient.shape[1])
    return np.clip(-np.linalg.solve(damped, gradient[..., None])[..., 0], -0.2, 0.2)


def _polished(cases: Sequence[Case], chi: np.ndarray) -> np.ndarray:
    """The minimum near chi (P,) within the range."""
    found = trust_region(
        lambda x: _residuals(cases, x[None])[0],
        np.clip(chi, STEP, 1 - STEP),
        jac=lambda x: _linear(cases, x[None])[1][0],
        bounds=(0, 1),
        x_scale="jac",
        loss="huber",
        f_scale=float(_limit(_residuals(cases, chi[None])[0])),
        max_nfev=POLISH,
    )
    return found.x


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
    values = values_of(cases[0].model.parameters, chi)
    parts = []
    for ready in cases:
        part = np.empty((len(values), 2 * len(ready.points)))
        for some, motion in ready.simulate(values):
            difference = (ready.at_measured(motion) - ready.points) / ready.sigma[None, :, None]
            part[some] = difference.reshape(len(difference), -1)
        parts.append(part)
    return np.nan_to_num(np.concatenate(parts, axis=1), nan=1e6)


def _costs(cases: Sequence[Case], chi: np.ndarray, limit: np.ndarray | float) -> np.ndarray:
    """Huber's mean squared residual of each candidate, chunk by chunk, (C,). limit: (C,) or one for all."""
    limits = np.broadcast_to(limit, len(chi))
    costs = []
    for some in np.array_split(np.arange(len(chi)), max(len(chi) // 64, 1)):
        size = np.abs(_residuals(cases, chi[some]))
        within = np.minimum(size, limits[some, None])
        costs.append(np.mean(within * (2 * size - within), axis=1))
    return np.concatenate(costs)


def _limit(residual: np.ndarray) -> np.ndarray:
    """HUBER robust standard deviations of residuals (..., N), (...)."""
    return HUBER * mad_sigma(residual, axis=-1) + 1e-12


def _huber(residual: np.ndarray, limit: np.ndarray) -> np.ndarray:
    """Weights of residuals (..., N): 1 within limit (...), less beyond."""
    return np.minimum(1.0, limit[..., None] / np.maximum(np.abs(residual), 1e-300))


def _blocks(cases: Sequence[Case]) -> list[np.ndarray]:
    """Indices of the residuals of each block of time of each trial."""
    blocks, first = [], 0
    for ready in cases:
        number = np.floor(ready.times[ready.frame] / BLOCK).astype(int).repeat(2)
        blocks += [first + np.flatnonzero(number == value) for value in np.unique(number)]
        first += len(number)
    return blocks
