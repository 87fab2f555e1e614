"""Fits of many theories side by side, by damped least squares.

Runs that share a model share a batch: the slopes of all of them are simulated together, and
then all their trial steps. Residuals are over the noise, so that a cost is twice a negative
log-likelihood, up to correlation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from stages.diagnose.evidence import Evidence
from stages.diagnose.theory import Theory
from stages.model.model import Model

STEP = 1e-4  # of chi, for slopes
PRIOR = 12.0  # one over the variance of a chi that may lie anywhere in [0, 1]
DAMPINGS = (1e-6, 1e-3, 1e-1, 10.0)
REACH = 0.25  # longest step of a chi
CONVERGED = 1e-4  # relative improvement of the cost
LITTLE = 0.2  # improvement of the cost that matters to nobody, in units of the log-likelihood


@dataclass(frozen=True)
class Fit:
    """A theory at its best. chi: (P,). residual: (N,) over sigma. slopes: (N, free) of the residual with chi."""

    theory: Theory
    chi: np.ndarray
    residual: np.ndarray
    slopes: np.ndarray

    @property
    def cost(self) -> float:
        """Half the sum of squares, with the prior: minus the log-likelihood of white noise."""
        return cost_of(self.theory, self.residual, self.chi)

    @cached_property
    def normal(self) -> np.ndarray:
        """(free, free) curvature of the cost."""
        return self.slopes.T @ self.slopes + PRIOR * np.eye(self.slopes.shape[1])

    @cached_property
    def values(self) -> dict[str, float]:
        """The free parameters by qualified name, in their units."""
        parameters = self.theory.model.parameters
        return {parameters[i].name: float(parameters[i].value(self.chi[i])) for i in self.theory.free}

    @property
    def mean_square(self) -> float:
        """Of the residual over sigma: 1 where only noise is left."""
        return float(np.mean(self.residual**2))


@dataclass
class _Run:
    """A fit under way."""

    theory: Theory
    chi: np.ndarray
    residual: np.ndarray
    slopes: np.ndarray
    cost: float = np.inf
    active: bool = True


def fitted(evidence: Evidence, theories: Sequence[Theory], starts: Sequence[np.ndarray], most: int) -> list[Fit]:
    """Each theory from its start (P,), at most `most` steps. Theories must share their model."""
    model = theories[0].model
    empty = np.empty(0)
    runs = [_Run(theory, chi.copy(), empty, empty) for theory, chi in zip(theories, starts, strict=True)]
    for _ in range(most):
        active = [run for run in runs if run.active]
        if not active:
            break
        _linearised(evidence, model, active)
        _stepped(evidence, model, active)
    _linearised(evidence, model, runs)
    return [Fit(run.theory, run.chi, run.residual, run.slopes) for run in runs]


def _linearised(evidence: Evidence, model: Model, runs: Sequence[_Run]) -> None:
    """Residual and slopes of each run where it is."""
    moved, signs = [], []
    for run in runs:
        free = run.theory.free
        sign = np.where(run.chi[free] > 0.5, -1.0, 1.0)
        rows = np.repeat(run.chi[None], len(free) + 1, axis=0)
        rows[1 + np.arange(len(free)), free] += STEP * sign
        moved.append(rows)
        signs.append(sign)
    seen = evidence.residuals(model, np.concatenate(moved))
    first = 0
    for run, rows, sign in zip(runs, moved, signs, strict=True):
        own = seen[first : first + len(rows)]
        first += len(rows)
        run.residual = own[0]
        run.slopes = ((own[1:] - own[0]) / (STEP * sign[:, None])).T
        run.cost = cost_of(run.theory, own[0], run.chi)


def _stepped(evidence: Evidence, model: Model, runs: Sequence[_Run]) -> None:
    """Each run to the best of several damped steps; one that hardly improves is done."""
    tried = np.concatenate([_steps(run) for run in runs])
    seen = evidence.residuals(model, tried)
    for number, run in enumerate(runs):
        some = slice(number * len(DAMPINGS), (number + 1) * len(DAMPINGS))
        costs = [_allowed_cost(run.theory, r, chi) for r, chi in zip(seen[some], tried[some], strict=True)]
        best = int(np.argmin(costs))
        better = run.cost - costs[best]
        run.active = better > max(CONVERGED * run.cost, LITTLE)
        if better > 0:
            run.chi, run.cost = tried[some][best], costs[best]


def _steps(run: _Run) -> np.ndarray:
    """Where damped steps lead, (dampings, P)."""
    return np.stack([newton(run.theory, run.chi, run.residual, run.slopes, damping) for damping in DAMPINGS])


def _allowed_cost(theory: Theory, residual: np.ndarray, chi: np.ndarray) -> float:
    """The cost at chi (P,), infinite where a cause would not be what it says."""
    return cost_of(theory, residual, chi) if theory.plausible(chi) else np.inf


def cost_of(theory: Theory, residual: np.ndarray, chi: np.ndarray) -> float:
    """Half the sum of squares of residual (N,) and of how far the free chi (P,) are from what is expected."""
    return float(0.5 * np.sum(residual**2) + 0.5 * PRIOR * np.sum((chi[theory.free] - theory.centre) ** 2))


def newton(theory: Theory, chi: np.ndarray, residual: np.ndarray, slopes: np.ndarray, damping: float) -> np.ndarray:
    """(P,) after a damped Gauss-Newton step from chi (P,); what is pushed against a bound stays there."""
    free = theory.free
    here = chi[free]
    gradient = slopes.T @ residual + PRIOR * (here - theory.centre)
    held = ((here <= 0) & (gradient > 0)) | ((here >= 1) & (gradient < 0))
    slopes = np.where(held, 0.0, slopes)
    normal = slopes.T @ slopes + PRIOR * np.eye(len(here))
    step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), -np.where(held, 0.0, gradient))
    result = chi.copy()
    result[free] = np.clip(here + step * min(1.0, REACH / max(np.abs(step).max(), 1e-12)), 0, 1)
    return result
