"""Damped least squares of many runs side by side, within bounds (Levenberg 1944,
Marquardt 1963).

An iteration is two batches: the forward differences of every run, then its trial steps.
Parameters are exponents chi in [0, 1] (Eq. 3). Two drags, or two dampings, that can
take each other's place leave a valley: bent in exponents, along which steps are short,
straight in values. So each step is tried along both lines: of 48 random starts in the
six hardest of 32 sets, 12 reached the best minimum by steps in exponents alone, 38 by
both.

The noise need not be known: an improvement is counted in the log-likelihood whose scale
is at its best, N/2 log(loss).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from stringcast.stages.inference.huber import huber_loss, huber_weights
from stringcast.stages.model.parameter import (
    Parameter,
    parameter_exponents,
    parameter_slopes,
    parameter_values,
)

# standard deviations: each residual of what cannot be simulated
DIVERGED_RESIDUAL = 1e3
MIN_GAIN = 0.05  # of the log-likelihood: an improvement that matters to nobody
MAX_ITERATIONS = 60  # at most; it mostly takes fewer than ten

# Differences of chi. A tenth of what is left keeps their error, half their width times
# the curvature, far below it. Rounding, 1e-13 of the points, is 1e-6 of a difference
# over the narrowest; over the widest any string is curved.
# of what is left: how far they should move the points, root mean square
DIFFERENCE_SHARE = 0.1
FIRST_DIFFERENCE, MIN_DIFFERENCE, MAX_DIFFERENCE = 1e-4, 1e-6, 1e-3

# Marquardt's damping, a share of the diagonal. Three are tried at once, as lanes of a
# batch cost next to nothing: with two, 0.05 and 3, a stiff strip's search crept along
# its valley, and ended 3,600 of the log-likelihood short.
INITIAL_DAMPING = 1e-2  # at first
# times the last that was right: one is within ten times the best
DAMPING_FACTORS = (1e-3, 0.1, 10.0)
DAMPING_INCREASE = 1e3  # times as much where none was right
# below which it does nothing, and above which no step is worth one
MIN_DAMPING, MAX_DAMPING = 1e-8, 1e4
# of the mean curvature, added to all: a direction without any stays put
FLAT_CURVATURE_SHARE = 1e-9

# of chi: the longest step straight in exponents, and in values
MAX_EXPONENT_STEP, MAX_VALUE_STEP = 0.3, 0.5
SMALLEST_FLOAT = float(np.finfo(float).tiny)


class Problem(Protocol):
    """What is fitted."""

    @property
    def parameters(self) -> Sequence[Parameter]:
        """Those of which chi (P,) are exponents."""

    @property
    def limit(self) -> float:
        """Size from which a residual counts less (Huber), or infinite."""

    def residuals(self, chi: np.ndarray) -> np.ndarray:
        """Of candidates (C, P), white, (C, N); LOST where one cannot be simulated."""


@dataclass
class SolverRuns:
    """Runs as far as they came.

    chi: (K, P). residual: (K, N). loss: (K,), as `huber.loss`. normal, gradient: of
    half the loss, (K, P, P) and (K, P); stale: (K,) where they are those of another
    place. width: (K, P) of chi, over which the next differences are taken. damping:
    (K,) that was right last. active: (K,) which may still gain.
    """

    chi: np.ndarray
    residual: np.ndarray
    loss: np.ndarray
    width: np.ndarray
    damping: np.ndarray
    stale: np.ndarray
    active: np.ndarray
    normal: np.ndarray = field(repr=False)
    gradient: np.ndarray = field(repr=False)

    @classmethod
    def start(cls, problem: Problem, chi: np.ndarray) -> SolverRuns:
        """At their starts (K, P)."""
        count, size = chi.shape
        residual = problem.residuals(chi)
        width, damping = (
            np.full(chi.shape, FIRST_DIFFERENCE),
            np.full(count, INITIAL_DAMPING),
        )
        stale, active = np.ones(count, dtype=bool), np.ones(count, dtype=bool)
        normal, gradient = np.zeros((count, size, size)), np.zeros((count, size))
        return cls(
            chi.copy(),
            residual,
            huber_loss(residual, problem.limit),
            width,
            damping,
            stale,
            active,
            normal,
            gradient,
        )


def fit_least_squares(
    problem: Problem,
    starts: np.ndarray,
    most: int = MAX_ITERATIONS,
    enough: float = MIN_GAIN,
) -> SolverRuns:
    """Each run from its start (K, P), `most` iterations at most, until one gains less
    than `enough`.
    """
    fits = SolverRuns.start(problem, starts)
    for _ in range(most):
        active = np.flatnonzero(fits.active)
        if not active.size:
            break
        _linearise_runs(problem, fits, active[fits.stale[active]])
        _step_runs(problem, fits, active, enough)
    return fits


def forward_differences(
    problem: Problem, chi: np.ndarray, residual: np.ndarray, width: np.ndarray
) -> np.ndarray:
    """Slopes (K, P, N) of the residuals (K, N) with chi (K, P): differences of this
    width (K, P), away from the nearer bound; none where a residual is lost.
    """
    count, size = chi.shape
    offset = np.where(chi > 0.5, -width, width)
    beside = chi[:, None] + offset[..., None] * np.eye(size)
    moved = problem.residuals(beside.reshape(-1, size)).reshape(count, size, -1)
    here = residual[:, None]
    lost = (moved == DIVERGED_RESIDUAL) | (here == DIVERGED_RESIDUAL)
    return np.where(lost, 0.0, moved - here) / offset[..., None]


def difference_widths(slope: np.ndarray, left: np.ndarray) -> np.ndarray:
    """Widths of differences (K, P) that move the points by a tenth of what is left.
    slope: (K, P, N). left: loss of each run, (K,).
    """
    size = np.sqrt(np.mean(slope**2, axis=-1))
    wanted = DIFFERENCE_SHARE * np.sqrt(left)[:, None]
    return np.clip(
        wanted / np.maximum(size, wanted / MAX_DIFFERENCE + SMALLEST_FLOAT),
        MIN_DIFFERENCE,
        MAX_DIFFERENCE,
    )


def _linearise_runs(problem: Problem, fits: SolverRuns, runs: np.ndarray) -> None:
    """Curvature and gradient of these runs where they are, and the width of their next
    differences.
    """
    if not runs.size:
        return
    residual = fits.residual[runs]
    slope = forward_differences(problem, fits.chi[runs], residual, fits.width[runs])
    weighted = (
        slope * huber_weights(residual, problem.limit)[:, None] / residual.shape[1]
    )
    fits.normal[runs] = weighted @ slope.transpose(0, 2, 1)
    fits.gradient[runs] = np.einsum("kpn,kn->kp", weighted, residual)
    fits.width[runs] = difference_widths(slope, fits.loss[runs])
    fits.stale[runs] = False


def _step_runs(
    problem: Problem, fits: SolverRuns, active: np.ndarray, enough: float
) -> None:
    """Each active run to the best of its trial steps, if that is better than where it
    is.
    """
    trials = np.stack([_trial_points(problem.parameters, fits, run) for run in active])
    count, size = trials.shape[1:]
    residuals = problem.residuals(trials.reshape(-1, size)).reshape(
        len(active), count, -1
    )
    losses = huber_loss(residuals, problem.limit)
    for run, place, residual, cost in zip(
        active, trials, residuals, losses, strict=True
    ):
        best = int(np.argmin(cost))
        gain = (
            0.5
            * residual.shape[1]
            * np.log(fits.loss[run] / max(cost[best], SMALLEST_FLOAT))
        )
        if gain > 0:
            fits.chi[run], fits.residual[run], fits.loss[run] = (
                place[best],
                residual[best],
                cost[best],
            )
        fits.stale[run] = gain > 0
        factor = (
            DAMPING_FACTORS[best % len(DAMPING_FACTORS)]
            if gain > 0
            else DAMPING_INCREASE
        )
        fits.damping[run] = max(fits.damping[run] * factor, MIN_DAMPING)
        fits.active[run] = (
            gain > enough if gain > 0 else fits.damping[run] < MAX_DAMPING
        )


def _trial_points(
    parameters: Sequence[Parameter], fits: SolverRuns, run: int
) -> np.ndarray:
    """Where damped steps of a run lead, (2 DAMPINGS, P): straight in exponents, then
    straight in values.
    """
    chi, normal, gradient = fits.chi[run], fits.normal[run], fits.gradient[run]
    diagonal = np.diag(normal)
    flat = FLAT_CURVATURE_SHARE * diagonal.mean() + SMALLEST_FLOAT
    damped = [
        normal + np.diag(fits.damping[run] * share * diagonal + flat)
        for share in DAMPING_FACTORS
    ]
    low, high = (
        np.maximum(chi - MAX_EXPONENT_STEP, 0.0),
        np.minimum(chi + MAX_EXPONENT_STEP, 1.0),
    )
    in_exponents = [
        chi + minimise_in_box(each, gradient, low - chi, high - chi) for each in damped
    ]
    value, rise = (
        parameter_values(parameters, chi),
        np.maximum(parameter_slopes(parameters, chi), SMALLEST_FLOAT),
    )
    ends = [np.clip(chi + way, 0.0, 1.0) for way in (-MAX_VALUE_STEP, MAX_VALUE_STEP)]
    with np.errstate(over="ignore"):  # where a value hardly rises there, no end is near
        low, high = ((parameter_values(parameters, end) - value) / rise for end in ends)
    in_values = [
        parameter_exponents(
            parameters, value + rise * minimise_in_box(each, gradient, low, high)
        )
        for each in damped
    ]
    return np.clip([*in_exponents, *in_values], 0.0, 1.0)


def minimise_in_box(
    normal: np.ndarray, gradient: np.ndarray, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """The step (P,) to the least of a quadratic between low <= 0 and high >= 0, by an
    active set.

    To the least of what is free, or as far as the first side, which then holds; in the
    end what would rather be off its side is let go (Nocedal and Wright 2006, Algorithm
    16.3).
    """
    # side: -1 at low, 1 at high, 0 where free
    step, side = np.zeros(len(gradient)), np.zeros(len(gradient))
    for _ in range(4 * len(gradient)):  # mostly two; each may be held and let go twice
        free, pull = side == 0, -gradient - normal @ step
        move = np.zeros(len(gradient))
        move[free] = np.linalg.solve(normal[np.ix_(free, free)], pull[free])
        room = np.where(move > 0, high - step, step - low)
        share = np.divide(
            room, np.abs(move), out=np.full(len(move), np.inf), where=move != 0
        )
        first = int(np.argmin(share))
        if share[first] < 1:
            step, side[first] = step + share[first] * move, np.sign(move[first])
            continue
        step = step + move
        inwards = -side * (-gradient - normal @ step)
        first = int(np.argmax(inwards))
        if inwards[first] <= 0:
            break
        side[first] = 0
    return np.clip(step, low, high)
