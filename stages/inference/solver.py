"""Damped least squares of many runs side by side, within bounds.

An iteration is two or three batches: the forward differences of every run, its least
damped steps, and the others where those gain less than the differences promise. Few
steps are tried in one batch, if that takes no longer. A run to which they promise next
to nothing ends, or one that twice gains little. One slow step may be a bend of the
valley, or one damped too little for it.
Parameters are exponents chi in [0, 1] (Eq. 3). Two parameters that can take each
other's place leave a valley: bent in exponents, along which steps are short, and
straight in values. So each step is tried along both lines: of 48 random starts in the
six hardest of 32 sets, 12 reached the best minimum by steps in exponents alone, 38 by
both.

The noise need not be known: a gain is one of the log-likelihood at the best scale of
the noise, N/2 log(loss). This only decides when a run ends.

References
----------
Levenberg 1944, Q. Appl. Math. 2, 164. Marquardt 1963, J. SIAM 11, 431.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
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
MIN_GAIN = 0.05  # of the log-likelihood: a step that gains less is slow
NEGLIGIBLE_SHARE = 0.01  # of that: where slopes promise less, no step is tried
# Of what slopes promise: where a step gains as much, none of more damping is tried
SUFFICIENT_SHARE = 0.8
MAX_ITERATIONS = 60  # at most; it mostly takes fewer than ten

# Widths of differences of chi. One that moves the points by a tenth of the residual
# keeps the error, half the width times the curvature, far below it. Rounding, 1e-13 of
# the points, is 1e-6 of a difference over the narrowest; over the widest any string is
# curved.
DIFFERENCE_SHARE = 0.1  # of the residual's root mean square
FIRST_DIFFERENCE = 1e-4
MIN_DIFFERENCE = 1e-6
MAX_DIFFERENCE = 1e-3

# Marquardt's damping, a share of the diagonal. Four are tried: with two, 0.05 and 3, a
# search for a stiff strip crept along its valley and ended 3,600 of the log-likelihood
# short.
INITIAL_DAMPING = 1e-2  # at first
DAMPING_FACTORS = (1e-3, 0.1, 1.0, 10.0)  # times the last that was right
DAMPING_INCREASE = 1e3  # times as much where none was right
MIN_DAMPING = 1e-8  # below which it has no effect
MAX_DAMPING = 1e4  # above which no step is worth one
# of the mean curvature, added to all: a direction without any stays put
FLAT_CURVATURE_SHARE = 1e-9

MAX_EXPONENT_STEP = 0.3  # of chi: the longest step straight in exponents
MAX_VALUE_STEP = 0.5  # of chi: the longest step straight in values
LEAST_LOSS_RATIO = 1e-300  # of the loss after a step to that before
SMALLEST_FLOAT = float(np.finfo(float).tiny)

# Of the residual, root mean square: runs that differ by less are in the same place
SAME_PLACE_TOLERANCE = 0.1


class Problem(Protocol):
    """The interface of a least-squares problem that the solver can minimise."""

    @property
    def parameters(self) -> Sequence[Parameter]:
        """The parameters whose exponents chi (P,) are fitted."""

    @property
    def limit(self) -> float:
        """The size from which a residual counts less (Huber), or infinite."""

    @property
    def candidates_at_once(self) -> int:
        """Number of candidates that take as long together as one."""

    def residuals(self, chi: np.ndarray) -> np.ndarray:
        """Compute white residuals (C, N) of candidates (C, P).

        They are DIVERGED_RESIDUAL where a run diverged.
        """


@dataclass
class SolverRuns:
    """The state of R runs.

    Parameters
    ----------
    chi
        Exponents, (R, P).
    held
        Exponents that stay as they are, (R, P).
    residual
        White residuals, (R, N).
    loss
        Of the residuals, as of `huber_loss`, (R,).
    width
        Of chi, over which the next differences are taken, (R, P).
    damping
        That was right last, (R,).
    stale
        Runs whose curvature and gradient are those of earlier exponents, (R,).
    is_slow
        Runs whose last step gained little, (R,).
    is_narrow
        Runs whose differences were narrowed, as no step gained anything, (R,).
    active
        Runs that may still gain, (R,).
    normal, gradient
        Curvature (R, P, P) and gradient (R, P) of half the loss.
    promise
        Share of the loss that the best step removes if slopes do not change, (R,).
    """

    chi: np.ndarray
    held: np.ndarray
    residual: np.ndarray
    loss: np.ndarray
    width: np.ndarray
    damping: np.ndarray
    stale: np.ndarray
    is_slow: np.ndarray
    is_narrow: np.ndarray
    active: np.ndarray
    normal: np.ndarray = field(repr=False)
    gradient: np.ndarray = field(repr=False)
    promise: np.ndarray

    @classmethod
    def start(
        cls, problem: Problem, chi: np.ndarray, held: np.ndarray | None = None
    ) -> SolverRuns:
        """Place the runs at their starts (R, P); by default none is held."""
        count, size = chi.shape
        residual = problem.residuals(chi)
        return cls(
            chi=chi.copy(),
            held=np.zeros(chi.shape, dtype=bool) if held is None else held,
            residual=residual,
            loss=huber_loss(residual, problem.limit),
            width=np.full(chi.shape, FIRST_DIFFERENCE),
            damping=np.full(count, INITIAL_DAMPING),
            stale=np.ones(count, dtype=bool),
            is_slow=np.zeros(count, dtype=bool),
            is_narrow=np.zeros(count, dtype=bool),
            active=np.ones(count, dtype=bool),
            normal=np.zeros((count, size, size)),
            gradient=np.zeros((count, size)),
            promise=np.zeros(count),
        )

    @property
    def promised_gains(self) -> np.ndarray:
        """Gains of the log-likelihood that the best steps promise, (R,)."""
        return np.asarray(0.5 * self.residual.shape[1] * self.promise)

    @property
    def log_likelihood_behind(self) -> np.ndarray:
        """Log-likelihood that each run is behind the best one, (R,)."""
        loss = np.maximum(self.loss, SMALLEST_FLOAT)
        return np.asarray(0.5 * self.residual.shape[1] * np.log(loss / loss.min()))

    def select(self, run: int) -> SolverRuns:
        """Select one of the runs."""
        values = {}
        for each in fields(self):
            values[each.name] = getattr(self, each.name)[run : run + 1].copy()
        return SolverRuns(**values)

    def reweight(self, problem: Problem) -> None:
        """Go on with the same residuals weighted otherwise."""
        self.residual = problem.residuals(self.chi)
        self.loss = huber_loss(self.residual, problem.limit)
        self.damping = np.minimum(self.damping, INITIAL_DAMPING)
        self.stale[:] = True
        self.is_slow[:] = False
        self.is_narrow[:] = False
        self.active[:] = True


def fit_least_squares(
    problem: Problem,
    starts: np.ndarray,
    max_iterations: int = MAX_ITERATIONS,
    min_gain: float = MIN_GAIN,
    max_promises_behind: float = np.inf,
    held: np.ndarray | None = None,
) -> SolverRuns:
    """Minimise the loss from several starts side by side.

    Parameters
    ----------
    starts
        Exponents, (R, P).
    max_iterations
        Iterations at most.
    min_gain
        A step that gains less of the log-likelihood is slow.
    max_promises_behind
        A run that is behind the best by more than so many times what its slopes promise
        is given up.
    held
        Exponents that stay where they start, (R, P).
    """
    runs = SolverRuns.start(problem, starts, held)
    for _ in range(max_iterations):
        if not runs.active.any():
            break
        iterate_runs(problem, runs, min_gain)
        promised = np.maximum(runs.promised_gains, SMALLEST_FLOAT)
        is_hopeless = runs.log_likelihood_behind > max_promises_behind * promised
        runs.active &= ~is_hopeless
    return runs


def distinct_starts(problem: Problem, starts: np.ndarray) -> np.ndarray:
    """Leave out starts (R, P) in the same place as a better one."""
    if len(starts) < 2:
        return starts
    residual = problem.residuals(starts)
    return starts[different_places(residual, huber_loss(residual, problem.limit))]


def different_places(residual: np.ndarray, loss: np.ndarray) -> list[int]:
    """Choose the best run in each place by its number, the best of all first.

    residual: of the runs, (R, N). loss: (R,).
    """
    chosen: list[int] = []
    for run in np.argsort(loss, kind="stable"):
        differences = residual[chosen] - residual[run]
        nearest = np.mean(differences**2, axis=1).min(initial=np.inf)
        if nearest > SAME_PLACE_TOLERANCE**2 * loss[run]:
            chosen.append(int(run))
    return chosen


def iterate_runs(problem: Problem, runs: SolverRuns, min_gain: float) -> None:
    """Linearise all active runs and move them. Parameters as of `fit_least_squares`."""
    active = np.flatnonzero(runs.active)
    _linearise_runs(problem, runs, active[runs.stale[active]])
    runs.active &= runs.promised_gains > NEGLIGIBLE_SHARE * min_gain
    active = np.flatnonzero(runs.active)
    if active.size:
        _step_runs(problem, runs, active, min_gain)


def forward_differences(
    problem: Problem,
    chi: np.ndarray,
    residual: np.ndarray,
    width: np.ndarray,
) -> np.ndarray:
    """Difference the residuals (R, N) at chi (R, P) over widths (R, P), (R, P, N).

    Differences point away from the nearer bound. Those of diverged runs are zero.
    """
    count, size = chi.shape
    offset = np.where(chi > 0.5, -width, width)
    points = chi[:, None] + offset[..., None] * np.eye(size)
    moved = problem.residuals(points.reshape(-1, size)).reshape(count, size, -1)
    start = residual[:, None]
    diverged = (moved == DIVERGED_RESIDUAL) | (start == DIVERGED_RESIDUAL)
    change = np.where(diverged, 0.0, moved - start)
    return change / offset[..., None]


def difference_widths(slope: np.ndarray, loss: np.ndarray) -> np.ndarray:
    """Choose widths (R, P) over which points move by a tenth of the residual.

    slope: of white residuals, (R, P, N). loss: of each run, (R,).
    """
    slope_rms = np.sqrt(np.mean(slope**2, axis=-1))
    change = DIFFERENCE_SHARE * np.sqrt(loss)[:, None]
    smallest_slope = change / MAX_DIFFERENCE + SMALLEST_FLOAT
    width = change / np.maximum(slope_rms, smallest_slope)
    return np.asarray(np.clip(width, MIN_DIFFERENCE, MAX_DIFFERENCE))


def _linearise_runs(problem: Problem, runs: SolverRuns, chosen: np.ndarray) -> None:
    """Update curvature, gradient and width of the chosen runs where they are."""
    if not chosen.size:
        return
    residual = runs.residual[chosen]
    width = runs.width[chosen]
    slope = forward_differences(problem, runs.chi[chosen], residual, width)
    weight = huber_weights(residual, problem.limit)[:, None]
    weighted = slope * weight / residual.shape[1]
    runs.normal[chosen] = weighted @ slope.transpose(0, 2, 1)
    runs.gradient[chosen] = np.einsum("rpn,rn->rp", weighted, residual)
    runs.width[chosen] = difference_widths(slope, runs.loss[chosen])
    runs.stale[chosen] = False
    for run in chosen:  # of half the loss
        free = ~runs.held[run]
        normal = runs.normal[run][np.ix_(free, free)]
        gain = promised_gain(normal, runs.gradient[run, free], runs.chi[run, free])
        runs.promise[run] = 2 * gain / max(runs.loss[run], SMALLEST_FLOAT)


def promised_gain(
    curvature: np.ndarray, gradient: np.ndarray, chi: np.ndarray
) -> float:
    """Compute by how much a quadratic falls to its minimum within [0, 1].

    Parameters
    ----------
    curvature, gradient
        At exponents chi (P,), (P, P) and (P,).
    """
    step = minimise_in_box(with_flat_curvature(curvature), gradient, -chi, 1.0 - chi)
    return float(-(gradient @ step + 0.5 * step @ curvature @ step))


def with_flat_curvature(curvature: np.ndarray) -> np.ndarray:
    """Add so little curvature (P, P) that only a direction without any stays put."""
    flat = FLAT_CURVATURE_SHARE * np.diag(curvature).mean() + SMALLEST_FLOAT
    return np.asarray(curvature + flat * np.eye(len(curvature)))


def _step_runs(
    problem: Problem,
    runs: SolverRuns,
    active: np.ndarray,
    min_gain: float,
) -> None:
    """Move each active run to the best of its trial steps, if that improves it."""
    points = np.stack([_trial_points(problem.parameters, runs, run) for run in active])
    residuals = np.zeros((*points.shape[:2], runs.residual.shape[1]))
    losses = np.full(points.shape[:2], np.inf)

    # The steps of least damping first, and the others where these gain too little;
    # all of them where that takes no longer
    sufficient = runs.loss[active] * (1 - SUFFICIENT_SHARE * runs.promise[active])
    is_least_damped = np.arange(points.shape[1]) % len(DAMPING_FACTORS) == 0
    batches = [is_least_damped, ~is_least_damped]
    if losses.size <= problem.candidates_at_once:
        batches = [np.ones_like(is_least_damped)]
    for chosen in batches:
        unsettled = np.flatnonzero(losses.min(axis=1) > sufficient)
        if not unsettled.size:
            break
        tried = np.ix_(unsettled, np.flatnonzero(chosen))
        simulated = problem.residuals(points[tried].reshape(-1, points.shape[-1]))
        residuals[tried] = simulated.reshape(len(unsettled), chosen.sum(), -1)
        losses[tried] = huber_loss(residuals[tried], problem.limit)

    for number, run in enumerate(active):
        best = int(np.argmin(losses[number]))
        lowest = losses[number, best]
        if lowest < runs.loss[run]:
            # finite even if nothing is left
            least = max(lowest, LEAST_LOSS_RATIO * runs.loss[run])
            gain = 0.5 * residuals.shape[-1] * np.log(runs.loss[run] / least)
            factor = DAMPING_FACTORS[best % len(DAMPING_FACTORS)]
            runs.chi[run] = points[number, best]
            runs.residual[run] = residuals[number, best]
            runs.loss[run] = lowest
            runs.damping[run] = max(runs.damping[run] * factor, MIN_DAMPING)
            runs.stale[run] = True
            runs.is_narrow[run] = False
            is_slow = gain <= min_gain
            if is_slow:
                is_promising = runs.promised_gains[run] > min_gain
                runs.active[run] = is_promising and not runs.is_slow[run]
            runs.is_slow[run] = is_slow
        elif runs.promised_gains[run] <= min_gain:
            runs.active[run] = False
        elif runs.damping[run] * DAMPING_INCREASE < MAX_DAMPING:
            runs.damping[run] *= DAMPING_INCREASE
        else:
            # No step gains anything: slopes over narrower differences may be right
            runs.active[run] = not runs.is_narrow[run]
            runs.is_narrow[run] = True
            runs.width[run] = np.maximum(0.1 * runs.width[run], MIN_DIFFERENCE)
            runs.damping[run] = INITIAL_DAMPING
            runs.stale[run] = True


def _trial_points(
    parameters: Sequence[Parameter],
    runs: SolverRuns,
    run: int,
) -> np.ndarray:
    """Compute trial steps of a run, straight in exponents, then straight in values.

    Returns exponents (2 len(DAMPING_FACTORS), P).
    """
    chi = runs.chi[run]
    normal = runs.normal[run]
    gradient = runs.gradient[run]
    diagonal = np.diag(normal)
    flat = FLAT_CURVATURE_SHARE * diagonal.mean() + SMALLEST_FLOAT

    free = ~runs.held[run]
    low = np.maximum(chi - MAX_EXPONENT_STEP * free, 0.0) - chi
    high = np.minimum(chi + MAX_EXPONENT_STEP * free, 1.0) - chi

    # A step in values is written as the step in exponents of the same slope
    value = parameter_values(parameters, chi)
    slope = np.maximum(parameter_slopes(parameters, chi), SMALLEST_FLOAT)
    reach = MAX_VALUE_STEP * free
    lowest = parameter_values(parameters, np.clip(chi - reach, 0.0, 1.0))
    highest = parameter_values(parameters, np.clip(chi + reach, 0.0, 1.0))
    with np.errstate(over="ignore"):  # where a value hardly rises, no end is near
        low_in_values = (lowest - value) / slope
        high_in_values = (highest - value) / slope

    in_exponents = []
    in_values = []
    for factor in DAMPING_FACTORS:
        damped = normal + np.diag(runs.damping[run] * factor * diagonal + flat)
        step = minimise_in_box(damped, gradient, low, high)
        in_exponents.append(chi + step)
        step = minimise_in_box(damped, gradient, low_in_values, high_in_values)
        in_values.append(parameter_exponents(parameters, value + slope * step))
    return np.asarray(np.clip([*in_exponents, *in_values], 0.0, 1.0))


def minimise_in_box(
    normal: np.ndarray,
    gradient: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
) -> np.ndarray:
    """Minimise a quadratic within bounds by an active set.

    Steps go to the minimum of the free parameters or to the first bound, which then
    holds. At the end a bound that the gradient points away from is released.

    Parameters
    ----------
    normal, gradient
        Curvature (P, P) and gradient (P,) at zero.
    low, high
        Bounds of the step, low <= 0 <= high, (P,).

    Returns
    -------
    The step, (P,).

    References
    ----------
    Nocedal and Wright 2006, Numerical Optimization, Algorithm 16.3.
    """
    size = len(gradient)
    step = np.zeros(size)
    side = np.zeros(size)  # -1 at the lower bound, 1 at the upper, 0 where free
    for _ in range(4 * size):  # mostly two; each bound may hold and be released twice
        free = side == 0
        descent = -gradient - normal @ step
        move = np.zeros(size)
        move[free] = np.linalg.solve(normal[np.ix_(free, free)], descent[free])
        room = np.where(move > 0, high - step, step - low)
        # Only a bound within the move counts; other shares may be too large for a float
        distance = np.abs(move)
        share = np.full(size, np.inf)
        is_near = (distance > room) & (distance > 0)
        np.divide(room, distance, out=share, where=is_near)

        first = int(np.argmin(share))
        if share[first] < 1:
            step = step + share[first] * move
            side[first] = np.sign(move[first])
            continue

        step = step + move
        descent = -gradient - normal @ step
        inwards = -side * descent
        steepest = int(np.argmax(inwards))
        if inwards[steepest] <= 0:
            break
        side[steepest] = 0
    return np.clip(step, low, high)
