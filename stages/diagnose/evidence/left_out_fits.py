"""Fits without some trials, from the fit to all of them.

Without a few trials the optimum hardly moves. So it is found by Gauss-Newton steps
with the slopes of the fit to all trials [1]_; each step simulates each trial once. If
these steps do not converge, the hypothesis is refitted. Nine or more trials are left
out in eight groups, so that the cost is linear in their number.

References
----------
.. [1] Rad, Maleki, J. R. Stat. Soc. B 82, 965 (2020).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stringcast.stages.inference.laplace import Fit, best_exponents
from stringcast.stages.inference.likelihood import PRIOR_PRECISION
from stringcast.stages.inference.solver import (
    DIVERGED_RESIDUAL,
    MIN_GAIN,
    minimise_in_box,
)
from stringcast.stages.inference.trial_data import ByTrial, TrialData
from stringcast.stages.workers import map_in_workers

MAX_GROUPS = 8  # of trials that are left out together
MAX_STEPS = 5  # with the same slopes; usually two are enough
FLAT_CURVATURE = 1e-9  # added so that directions without curvature do not move


def groups_to_leave_out(trials: int) -> list[list[int]]:
    """Divide the indices of trials into groups that are left out in turn."""
    count = min(trials, MAX_GROUPS)
    return [list(range(first, trials, count)) for first in range(count)]


def exponents_without_groups(
    data: TrialData,
    fit: Fit,
    groups: Sequence[Sequence[int]],
) -> list[np.ndarray]:
    """Fit a hypothesis without the trials of each group.

    Returns exponents (P,) for each group.
    """
    steps = _GaussNewtonSteps(data, fit, groups)
    steps.run()

    def refit_without_group(number: int) -> np.ndarray:
        others = [k for k in range(len(data.trials)) if k not in groups[number]]
        chi, _ = best_exponents(
            data.subset(others),
            fit.hypothesis,
            fit.chi[None],
            fit.grid_points[others],
            width=fit.width,
        )
        return chi

    exponents = list(steps.chi)
    refitted = np.flatnonzero(~steps.has_converged).tolist()
    refits = map_in_workers(refit_without_group, refitted)
    for number, chi in zip(refitted, refits, strict=True):
        exponents[number] = chi
    return exponents


class _GaussNewtonSteps:
    """Gauss-Newton steps of all groups in parallel, with the slopes of one fit.

    Attributes
    ----------
    chi : numpy.ndarray, shape (G, P)
    has_converged : numpy.ndarray of bool, shape (G,)
        Whether a further step gains less than MIN_GAIN.
    """

    def __init__(
        self,
        data: TrialData,
        fit: Fit,
        groups: Sequence[Sequence[int]],
    ) -> None:
        self.data = data.for_hypothesis(fit.hypothesis)
        self.fit = fit
        self.slopes = self.data.whiten_by_trial(fit.slopes, fit.grid_points)
        precision = np.zeros(len(fit.chi))
        precision[fit.hypothesis.base_indices] = PRIOR_PRECISION
        self.prior_precision = precision
        self.is_used = np.ones((len(groups), len(data.trials)))  # 0 where left out
        for number, group in enumerate(groups):
            self.is_used[number, list(group)] = 0.0

        information = np.stack([slope @ slope.T for slope in self.slopes])  # (K, P, P)
        self.curvature = np.einsum("gk,kpq->gpq", self.is_used, information)
        self.curvature += np.diag(precision + FLAT_CURVATURE)
        self.chi = np.repeat(fit.chi[None], len(groups), axis=0)
        self.has_converged = np.zeros(len(groups), dtype=bool)

    def run(self) -> None:
        """Move all groups until they converge or their loss rises."""
        residuals: ByTrial = [
            np.repeat(residual[None], len(self.chi), axis=0)
            for residual in self.fit.residuals
        ]
        active = np.arange(len(self.chi))
        first_loss = np.full(len(self.chi), np.inf)
        for number in range(MAX_STEPS + 1):
            loss, gradient = self._loss_and_gradient(active, residuals)
            if number == 0:
                first_loss = loss
            steps, gains = self._steps(active, gradient)
            # Groups whose loss rose or diverged stop without convergence
            is_better = loss <= first_loss[active]
            self.has_converged[active] = is_better & (gains < MIN_GAIN)
            goes_on = is_better & ~(gains < MIN_GAIN)
            active = active[goes_on]
            if not active.size or number == MAX_STEPS:
                return
            self.chi[active] += steps[goes_on]
            model = self.fit.hypothesis.model
            residuals = self.data.residuals(model, self.chi[active])

    def _loss_and_gradient(
        self,
        active: np.ndarray,
        residuals: ByTrial,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute half the sum of squares of groups (G,), and its gradient (G, P)."""
        from_middle = self.chi[active] - 0.5
        gradient = self.prior_precision * from_middle
        loss = 0.5 * np.sum(gradient * from_middle, axis=1)
        white = self.data.whiten_by_trial(residuals, self.fit.grid_points)
        for k, slope in enumerate(self.slopes):
            used = self.is_used[active, k]
            diverged = (residuals[k] == DIVERGED_RESIDUAL).any(axis=1)
            square = np.where(diverged, np.inf, np.sum(white[k] ** 2, axis=1))
            loss += np.where(used > 0, 0.5 * square, 0.0)
            gradient += used[:, None] * (white[k] @ slope.T)
        return loss, gradient

    def _steps(
        self,
        active: np.ndarray,
        gradient: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Minimise each group's quadratic; return steps (G, P) and their gains (G,)."""
        steps = []
        gains = []
        for number, group in enumerate(active):
            curvature = self.curvature[group]
            chi = self.chi[group]
            step = minimise_in_box(curvature, gradient[number], -chi, 1.0 - chi)
            gain = -gradient[number] @ step - 0.5 * step @ curvature @ step
            steps.append(step)
            gains.append(gain)
        return np.stack(steps), np.array(gains)
