"""Levenberg-Marquardt least squares of many runs in parallel, within bounds.

An iteration simulates two or three batches: the forward differences of every run, its
least damped steps, and its other steps where those gain less than the slopes predict.
If it takes no longer, all steps are one batch. A run stops when its slopes predict a
negligible gain, or after two slow steps in a row. A single slow step does not stop it:
the valley may bend there, or the damping may be too low.

Parameters are exponents chi in [0, 1] (Eq. 3). Two parameters with similar effects make
the minimum a valley. It is curved in exponents, where steps are therefore short, and
straight in values. So each step is tried along a line in exponents and along one in
values: of 48 random starts in the six hardest of 32 sets, 38 reached the best minimum
with both lines, 12 with exponents alone.

The noise level need not be known: gains are measured as N/2 log(loss), the
log-likelihood at the best noise level. They only decide when a run stops.

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

# standard deviations: residuals of a simulation that diverged
DIVERGED_RESIDUAL = 1e3
MIN_GAIN = 0.05  # in log-likelihood: a step that gains less is slow
NEGLIGIBLE_SHARE = 0.01  # of MIN_GAIN: no step is tried for a smaller predicted gain
# Of the predicted gain: after a step that gains as much, no more damping is tried
SUFFICIENT_SHARE = 0.8
MAX_ITERATIONS = 60  # most runs take fewer than ten
# Of the gain that its slopes predict: a start further behind the best is dropped. In
# ten drawn trials a start behind by twice its predicted gain still became the best, and
# one behind by 25 times did not.
MAX_GAINS_BEHIND = 10.0

# Widths of finite differences of chi. A width that moves the points by a tenth of the
# residual keeps the truncation error (half the width times the curvature) far below the
# residual. Rounding, 1e-13 of the points, is 1e-6 of the narrowest difference. Over the
# widest, any string responds nonlinearly.
DIFFERENCE_SHARE = 0.1  # of the residual's root mean square
FIRST_DIFFERENCE = 1e-4
MIN_DIFFERENCE = 1e-6
MAX_DIFFERENCE = 1e-3

# Marquardt's damping, relative to the diagonal. Four factors are tried: with two, 0.05
# and 3, the search for a stiff strip crept along its valley and ended 3,600 below the
# best log-likelihood.
INITIAL_DAMPING = 1e-2
DAMPING_FACTORS = (1e-3, 0.1, 1.0, 10.0)  # times the damping of the last good step
DAMPING_INCREASE = 1e3  # factor where no step was good
MIN_DAMPING = 1e-8  # less has no effect
MAX_DAMPING = 1e4  # with more, steps are too short to gain anything
# of the mean curvature, added everywhere so that directions without any do not move
FLAT_CURVATURE_SHARE = 1e-9

MAX_EXPONENT_STEP = 0.3  # in chi, for steps along a line in exponents
MAX_VALUE_STEP = 0.5  # in chi, for steps along a line in values
LEAST_LOSS_RATIO = 1e-300  # of the loss after a step to that before
SMALLEST_FLOAT = float(np.finfo(float).tiny)

# Of the residual's root mean square: runs that differ by less have the same solution
SAME_SOLUTION_TOLERANCE = 0.1


class Problem(Protocol):
    """The interface of a least-squares problem that the solver can minimise."""

    @property
    def parameters(self) -> Sequence[Parameter]:
        """The parameters whose exponents chi (P,) are fitted."""

    @property
    def limit(self) -> float:
        """Huber's limit, above which a residual has less weight, or infinite."""

    @property
    def candidates_at_once(self) -> int:
        """Number of candidates that take as long together as one."""

    def residuals(self, chi: np.ndarray) -> np.ndarray:
        """Compute white residuals (C, N) of candidates (C, P).

        They are DIVERGED_RESIDUAL where a simulation diverged.
        """


@dataclass
class SolverRuns:
    """The state of R runs.

    Parameters
    ----------
    chi
        Exponents, (R, P).
    is_fixed
        Whether an exponent is kept fixed, (R, P).
    residual
        White residuals, (R, N).
    loss
        Huber loss of the residuals, (R,).
    width
        Widths of chi for the next differences, (R, P).
    used_width
        Widths of the differences in curvature and gradient, (R, P).
    damping
        Damping of the last good step, (R,).
    stale
        Whether curvature and gradient belong to earlier exponents, (R,).
    is_slow
        Whether the last step gained little, (R,).
    is_narrow
        Whether differences were narrowed because no step gained anything, (R,).
    active
        Whether the run goes on, (R,).
    normal, gradient
        Curvature (R, P, P) and gradient (R, P) of half the loss.
    predicted_share
        Share of the loss that the best step removes if slopes are constant, (R,).
    """

    chi: np.ndarray
    is_fixed: np.ndarray
    residual: np.ndarray
    loss: np.ndarray
    width: np.ndarray
    used_width: np.ndarray
    damping: np.ndarray
    stale: np.ndarray
    is_slow: np.ndarray
    is_narrow: np.ndarray
    active: np.ndarray
    normal: np.ndarray = field(repr=False)
    gradient: np.ndarray = field(repr=False)
    predicted_share: np.ndarray

    @classmethod
    def start(
        cls,
        problem: Problem,
        chi: np.ndarray,
        is_fixed: np.ndarray | None = None,
        width: np.ndarray | None = None,
    ) -> SolverRuns:
        """Start runs at exponents (R, P); by default none is fixed.

        width: of their first differences, (P,).
        """
        count, size = chi.shape
        residual = problem.residuals(chi)
        if width is None:
            width = np.full(size, FIRST_DIFFERENCE)
        if is_fixed is None:
            is_fixed = np.zeros(chi.shape, dtype=bool)
        return cls(
            chi=chi.copy(),
            is_fixed=is_fixed,
            residual=residual,
            loss=huber_loss(residual, problem.limit),
            width=np.tile(width, (count, 1)),
            used_width=np.tile(width, (count, 1)),
            damping=np.full(count, INITIAL_DAMPING),
            stale=np.ones(count, dtype=bool),
            is_slow=np.zeros(count, dtype=bool),
            is_narrow=np.zeros(count, dtype=bool),
            active=np.ones(count, dtype=bool),
            normal=np.zeros((count, size, size)),
            gradient=np.zeros((count, size)),
            predicted_share=np.zeros(count),
        )

    @property
    def predicted_gains(self) -> np.ndarray:
        """Gains in log-likelihood that the slopes predict for the best steps, (R,)."""
        return np.asarray(0.5 * self.residual.shape[1] * self.predicted_share)

    @property
    def log_likelihood_behind(self) -> np.ndarray:
        """Log-likelihood of the best run minus that of each, (R,)."""
        loss = np.maximum(self.loss, SMALLEST_FLOAT)
        return np.asarray(0.5 * self.residual.shape[1] * np.log(loss / loss.min()))

    def select(self, run: int) -> SolverRuns:
        """Select one of the runs."""
        values = {}
        for item in fields(self):
            values[item.name] = getattr(self, item.name)[run : run + 1].copy()
        return SolverRuns(**values)

    def reweight(self, problem: Problem) -> None:
        """Continue all runs with the problem's present weights."""
        # Differences that were simulated at these exponents are not simulated again
        is_stale = self.stale[:, None]
        self.width = np.where(is_stale, self.width, self.used_width)
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
    max_gains_behind: float = np.inf,
    is_fixed: np.ndarray | None = None,
    width: np.ndarray | None = None,
) -> SolverRuns:
    """Minimise the loss from several starts in parallel.

    Parameters
    ----------
    starts
        Exponents, (R, P).
    min_gain
        A step that gains less log-likelihood is slow.
    max_gains_behind
        A run stops if it is further behind the best than this multiple of the gain that
        its slopes predict.
    is_fixed
        Whether an exponent is kept fixed, (R, P).
    width
        Widths of the first differences, (P,), if an earlier fit has chosen them.
    """
    runs = SolverRuns.start(problem, starts, is_fixed, width)
    for _ in range(max_iterations):
        if not runs.active.any():
            break
        iterate_runs(problem, runs, min_gain)
        predicted = np.maximum(runs.predicted_gains, SMALLEST_FLOAT)
        is_hopeless = runs.log_likelihood_behind > max_gains_behind * predicted
        runs.active &= ~is_hopeless
    return runs


def distinct_starts(problem: Problem, starts: np.ndarray) -> np.ndarray:
    """Drop starts (R, P) that simulate as a better one does."""
    if len(starts) < 2:
        return starts
    residual = problem.residuals(starts)
    return starts[distinct_solutions(residual, huber_loss(residual, problem.limit))]


def distinct_solutions(residual: np.ndarray, loss: np.ndarray) -> list[int]:
    """Find the indices of the best run with each solution, the best of all first.

    Runs have the same solution if their residuals (R, N) hardly differ. loss: (R,).
    """
    chosen: list[int] = []
    for run in np.argsort(loss, kind="stable"):
        differences = residual[chosen] - residual[run]
        nearest = np.mean(differences**2, axis=1).min(initial=np.inf)
        if nearest > SAME_SOLUTION_TOLERANCE**2 * loss[run]:
            chosen.append(int(run))
    return chosen


def iterate_runs(problem: Problem, runs: SolverRuns, min_gain: float) -> None:
    """Linearise all active runs and move them (min_gain: see `fit_least_squares`)."""
    active = np.flatnonzero(runs.active)
    _linearise_runs(problem, runs, active[runs.stale[active]])
    runs.active &= runs.predicted_gains > NEGLIGIBLE_SHARE * min_gain
    active = np.flatnonzero(runs.active)
    if active.size:
        _step_runs(problem, runs, active, min_gain)


def forward_differences(
    problem: Problem,
    chi: np.ndarray,
    residual: np.ndarray,
    width: np.ndarray,
) -> np.ndarray:
    """Compute forward differences of the residuals (R, N) at chi (R, P), (R, P, N).

    Widths (R, P) point away from the nearer bound. Slopes of diverged simulations are
    zero.
    """
    count, size = chi.shape
    offset = difference_offsets(chi, width)
    points = chi[:, None] + offset[..., None] * np.eye(size)
    moved = problem.residuals(points.reshape(-1, size)).reshape(count, size, -1)
    changes = residual_changes(moved, residual[:, None])
    return np.asarray(changes / offset[..., None])


def difference_offsets(chi: np.ndarray, width: np.ndarray | float) -> np.ndarray:
    """Choose offsets of exponents (..., P) over a width, away from the nearer bound."""
    return np.where(chi > 0.5, -width, width)


def difference_exponents(
    chi: np.ndarray, width: np.ndarray | float
) -> tuple[np.ndarray, np.ndarray]:
    """Vary each of the exponents (P,) by a width, away from the nearer bound.

    Returns exponents (1 + P, P), the given ones first, and their offsets (P,).
    """
    offset = difference_offsets(chi, width)
    return np.concatenate([chi[None], chi + np.diag(offset)]), offset


def residual_changes(moved: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Subtract residuals from others; those of diverged runs do not change."""
    diverged = (moved == DIVERGED_RESIDUAL) | (start == DIVERGED_RESIDUAL)
    return np.where(diverged, 0.0, moved - start)


def difference_widths(slope: np.ndarray, loss: np.ndarray) -> np.ndarray:
    """Choose widths (R, P) over which points move by a tenth of the residual.

    slope: white residuals per chi, (R, P, N). loss: (R,).
    """
    slope_rms = np.sqrt(np.mean(slope**2, axis=-1))
    change = DIFFERENCE_SHARE * np.sqrt(loss)[:, None]
    smallest_slope = change / MAX_DIFFERENCE + SMALLEST_FLOAT
    width = change / np.maximum(slope_rms, smallest_slope)
    return np.asarray(np.clip(width, MIN_DIFFERENCE, MAX_DIFFERENCE))


def _linearise_runs(problem: Problem, runs: SolverRuns, chosen: np.ndarray) -> None:
    """Update curvature, gradient and width of the chosen runs."""
    if not chosen.size:
        return
    residual = runs.residual[chosen]
    width = runs.width[chosen]
    slope = forward_differences(problem, runs.chi[chosen], residual, width)
    weight = huber_weights(residual, problem.limit)[:, None]
    weighted = slope * weight / residual.shape[1]
    runs.normal[chosen] = weighted @ slope.transpose(0, 2, 1)
    runs.gradient[chosen] = np.einsum("rpn,rn->rp", weighted, residual)
    runs.used_width[chosen] = width
    runs.width[chosen] = difference_widths(slope, runs.loss[chosen])
    runs.stale[chosen] = False
    for run in chosen:  # normal and gradient are those of half the loss
        free = ~runs.is_fixed[run]
        normal = runs.normal[run][np.ix_(free, free)]
        gain = predicted_gain(normal, runs.gradient[run, free], runs.chi[run, free])
        runs.predicted_share[run] = 2 * gain / max(runs.loss[run], SMALLEST_FLOAT)


def predicted_gain(
    curvature: np.ndarray, gradient: np.ndarray, chi: np.ndarray
) -> float:
    """Compute how far a quadratic falls from chi (P,) to its minimum in [0, 1].

    curvature (P, P), gradient (P,): at chi.
    """
    step = minimise_in_box(with_flat_curvature(curvature), gradient, -chi, 1.0 - chi)
    return float(-(gradient @ step + 0.5 * step @ curvature @ step))


def with_flat_curvature(curvature: np.ndarray) -> np.ndarray:
    """Add a little curvature (P, P) so that directions without any do not move."""
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
    predicted_share = runs.predicted_share[active]
    sufficient = runs.loss[active] * (1 - SUFFICIENT_SHARE * predicted_share)
    residuals = np.zeros((*points.shape[:2], runs.residual.shape[1]))  # (A, T, N)
    losses = _try_steps(problem, points, sufficient, residuals)  # (A, T)
    for number, run in enumerate(active):
        best = int(np.argmin(losses[number]))
        loss = losses[number, best]
        if loss < runs.loss[run]:
            factor = DAMPING_FACTORS[best % len(DAMPING_FACTORS)]
            runs.damping[run] = max(runs.damping[run] * factor, MIN_DAMPING)
            chi = points[number, best]
            _accept_step(runs, run, chi, residuals[number, best], loss, min_gain)
        else:
            _reject_steps(runs, run, min_gain)


def _try_steps(
    problem: Problem,
    points: np.ndarray,
    sufficient: np.ndarray,
    residuals: np.ndarray,
) -> np.ndarray:
    """Compute the losses of trial steps (A, T, P), (A, T), and fill in their residuals.

    The least damped steps of a run come first. The others are tried where none of these
    reaches a sufficient loss (A,); else their loss is infinite. If all steps take no
    longer than one, they are one batch.

    residuals: (A, T, N).
    """
    losses = np.full(points.shape[:2], np.inf)
    is_least_damped = np.arange(points.shape[1]) % len(DAMPING_FACTORS) == 0
    batches = [is_least_damped, ~is_least_damped]
    if losses.size <= problem.candidates_at_once:
        batches = [np.ones_like(is_least_damped)]
    for is_tried in batches:
        unsettled = np.flatnonzero(losses.min(axis=1) > sufficient)
        if not unsettled.size:
            break
        tried = np.ix_(unsettled, np.flatnonzero(is_tried))
        simulated = problem.residuals(points[tried].reshape(-1, points.shape[-1]))
        residuals[tried] = simulated.reshape(len(unsettled), is_tried.sum(), -1)
        losses[tried] = huber_loss(residuals[tried], problem.limit)
    return losses


def _accept_step(
    runs: SolverRuns,
    run: int,
    chi: np.ndarray,
    residual: np.ndarray,
    loss: float,
    min_gain: float,
) -> None:
    """Move a run to exponents (P,) with a lower loss; end it after two slow steps."""
    # Keeps the gain finite if the loss is zero
    least = max(loss, LEAST_LOSS_RATIO * runs.loss[run])
    gain = 0.5 * len(residual) * np.log(runs.loss[run] / least)
    is_slow = gain <= min_gain
    if is_slow:
        may_gain = runs.predicted_gains[run] > min_gain
        runs.active[run] = may_gain and not runs.is_slow[run]
    runs.is_slow[run] = is_slow
    runs.is_narrow[run] = False
    runs.chi[run] = chi
    runs.residual[run] = residual
    runs.loss[run] = loss
    runs.stale[run] = True


def _reject_steps(runs: SolverRuns, run: int, min_gain: float) -> None:
    """Damp the next steps of a run more, narrow its differences, or end it."""
    if runs.predicted_gains[run] <= min_gain:
        runs.active[run] = False
    elif runs.damping[run] * DAMPING_INCREASE < MAX_DAMPING:
        runs.damping[run] *= DAMPING_INCREASE
    else:
        # No step gains anything: narrower differences may give better slopes
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
    """Compute exponents (2 len(DAMPING_FACTORS), P) after each trial step of a run.

    Steps along a line in exponents come first, then those along a line in values.
    """
    chi = runs.chi[run]
    normal = runs.normal[run]
    gradient = runs.gradient[run]
    diagonal = np.diag(normal)
    flat = FLAT_CURVATURE_SHARE * diagonal.mean() + SMALLEST_FLOAT

    free = ~runs.is_fixed[run]
    low = np.maximum(chi - MAX_EXPONENT_STEP * free, 0.0) - chi
    high = np.minimum(chi + MAX_EXPONENT_STEP * free, 1.0) - chi

    # Steps in values are in units of exponents: divided by the slope at chi
    value = parameter_values(parameters, chi)
    slope = np.maximum(parameter_slopes(parameters, chi), SMALLEST_FLOAT)
    reach = MAX_VALUE_STEP * free
    lowest = parameter_values(parameters, np.clip(chi - reach, 0.0, 1.0))
    highest = parameter_values(parameters, np.clip(chi + reach, 0.0, 1.0))
    with np.errstate(over="ignore"):  # a small slope makes the bounds infinite
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
    """Minimise a quadratic within bounds by the active-set method.

    Each step goes to the minimum over the free parameters or to the first bound, which
    then becomes active. At a minimum, the active bound with the steepest descent
    inwards is released.

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
    for _ in range(4 * size):  # usually two; a bound may be set and released twice
        free = side == 0
        descent = -gradient - normal @ step
        move = np.zeros(size)
        move[free] = np.linalg.solve(normal[np.ix_(free, free)], descent[free])
        room = np.where(move > 0, high - step, step - low)
        # Only bounds within the move: other shares could overflow
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
