"""Fits of many theories side by side, by damped least squares.

Runs that share a model share a batch: the slopes of all of them are simulated together, and
then all their trial steps. Residuals are over the noise, so that a cost is a negative
log-likelihood, up to correlation.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from stringcast.stages.diagnose.evidence import LOST, Evidence
from stringcast.stages.diagnose.theory import Theory
from stringcast.stages.model.effect import Effect
from stringcast.stages.model.model import Model

STEP = 1e-4  # of chi, for slopes
PRIOR = 12.0  # one over the variance of a chi that may lie anywhere in [0, 1]
DAMPINGS = (1e-3, 1e-1, 10.0)  # of steps straight in exponents
IN_VALUES = (1e-6, 1e-3, 1e-1)  # and of those straight in values
REACH = 0.25  # longest step of a chi, where all are shortened alike
FURTHER = 0.5  # longest step of a chi, where values and not exponents go straight
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
    """A fit under way. residual: where it is, empty until that was simulated. active: whether it moved since its slopes
    were found by what matters to anybody."""

    theory: Theory
    chi: np.ndarray
    residual: np.ndarray = field(default_factory=lambda: np.empty(0))
    slopes: np.ndarray = field(default_factory=lambda: np.empty(0))
    cost: float = np.inf
    active: bool = True


def fitted(evidence: Evidence, theories: Sequence[Theory], starts: Sequence[np.ndarray], most: int) -> list[Fit]:
    """Each theory from its start (P,), at most `most` steps; those with the same effects at hand side by side.

    Theories must share their model but for its effects.
    """
    runs = [_Run(theory, chi.copy()) for theory, chi in zip(theories, starts, strict=True)]
    together: dict[tuple[type[Effect], ...], list[_Run]] = {}
    for run in runs:
        together.setdefault(run.theory.model.effects, []).append(run)
    for some in together.values():
        _go_on(evidence, some, most)
    return [Fit(run.theory, run.chi, run.residual, run.slopes) for run in runs]


def fixed(fit: Fit, causes: Collection[str]) -> Fit:
    """The fit with some of its causes as they are: no longer to be fitted."""
    theory = replace(fit.theory, causes=tuple(each for each in fit.theory.causes if each.name not in causes))
    return Fit(theory, fit.chi, fit.residual, fit.slopes[:, np.isin(fit.theory.free, theory.free)])


def ranked(fits: Sequence[Fit]) -> list[Fit]:
    """Best first."""
    return sorted(fits, key=lambda fit: fit.cost)


def _go_on(evidence: Evidence, runs: Sequence[_Run], most: int) -> None:
    """Fits that share their model, to their ends."""
    model = runs[0].theory.model
    for number in range(most + 1):
        active = [run for run in runs if run.active]
        if not active:
            break
        _linearised(evidence, model, active)
        if number < most:
            _stepped(evidence, model, active)


def _linearised(evidence: Evidence, model: Model, runs: Sequence[_Run]) -> None:
    """Residual and slopes of each run where it is."""
    asked = [_beside(run) for run in runs]
    seen = evidence.residuals(model, np.concatenate(asked))
    first = 0
    for run, rows in zip(runs, asked, strict=True):
        own = seen[first : first + len(rows)]
        first += len(rows)
        if not run.residual.size:
            run.residual, own = own[0], own[1:]
        lost = (own == LOST) | (run.residual == LOST)  # a run that was rejected tells no slope
        change = np.where(lost, 0.0, own - run.residual)
        run.slopes = (change / _offsets(run)[:, None]).T
        run.cost = cost_of(run.theory, run.residual, run.chi)


def _beside(run: _Run) -> np.ndarray:
    """Exponents (free, P) a little off in one of them each; with those of the run first, if they were not simulated."""
    free = run.theory.free
    rows = np.repeat(run.chi[None], len(free) + 1, axis=0)
    rows[1 + np.arange(len(free)), free] += _offsets(run)
    return rows[1:] if run.residual.size else rows


def _offsets(run: _Run) -> np.ndarray:
    """How far off, (free,): away from the nearer end of the range."""
    return STEP * np.where(run.chi[run.theory.free] > 0.5, -1.0, 1.0)


def _stepped(evidence: Evidence, model: Model, runs: Sequence[_Run]) -> None:
    """Each run to the best of several damped steps; one that hardly improves is done, its slopes as they are."""
    tried = [_steps(run) for run in runs]
    seen = np.split(evidence.residuals(model, np.concatenate(tried)), len(runs))
    for run, some, residuals in zip(runs, tried, seen, strict=True):
        costs = [_allowed_cost(run.theory, r, chi) for r, chi in zip(residuals, some, strict=True)]
        best = int(np.argmin(costs))
        better = run.cost - costs[best]
        run.active = better > max(CONVERGED * run.cost, LITTLE)
        if better > 0:
            run.chi, run.residual, run.cost = some[best], residuals[best].copy(), costs[best]


def _steps(run: _Run) -> np.ndarray:
    """Where damped steps lead, (dampings, P): straight in exponents, and straight in values.

    Of two drags, or two dampings, one may take the place of the other: their sum is what the data know. In exponents
    that is a bent valley, along which steps are short; in values it is straight.
    """
    free, chi = run.theory.free, run.chi
    ways = {
        damping: newton_step(run.theory, chi, run.residual, run.slopes, damping) for damping in {*DAMPINGS, *IN_VALUES}
    }
    steps = [shortened(ways[damping]) for damping in DAMPINGS]
    steps += [_in_values(run.theory, ways[damping]) for damping in IN_VALUES]
    moved = np.repeat(chi[None], len(steps), axis=0)
    moved[:, free] += np.stack(steps)
    return np.clip(moved, 0, 1)


def shortened(step: np.ndarray) -> np.ndarray:
    """A step of exponents, of at most REACH."""
    return step * min(1.0, REACH / max(np.abs(step).max(), 1e-12))


def _in_values(theory: Theory, step: np.ndarray) -> np.ndarray:
    """The step of exponents (free,) by which values change as much as they would at the beginning of the given one."""
    decades = theory.decades
    growth = 1 + decades * step
    straight = np.where(decades > 0, np.log(np.maximum(growth, 1e-9)) / np.maximum(decades, 1e-9), step)
    return np.clip(straight, -FURTHER, FURTHER)


def _allowed_cost(theory: Theory, residual: np.ndarray, chi: np.ndarray) -> float:
    """The cost at chi (P,), infinite where a cause would not be what it says."""
    return cost_of(theory, residual, chi) if theory.plausible(chi) else np.inf


def cost_of(theory: Theory, residual: np.ndarray, chi: np.ndarray) -> float:
    """Half the sum of squares of residual (N,) and of how far the free chi (P,) are from what is expected."""
    return float(0.5 * np.sum(residual**2) + 0.5 * PRIOR * np.sum((chi[theory.free] - theory.centre) ** 2))


def newton_step(
    theory: Theory, chi: np.ndarray, residual: np.ndarray, slopes: np.ndarray, damping: float
) -> np.ndarray:
    """The damped Gauss-Newton step (free,) from chi (P,); what is pushed against a bound stays there."""
    here = chi[theory.free]
    gradient = slopes.T @ residual + PRIOR * (here - theory.centre)
    held = ((here <= 0) & (gradient > 0)) | ((here >= 1) & (gradient < 0))
    slopes = np.where(held, 0.0, slopes)
    normal = slopes.T @ slopes + PRIOR * np.eye(len(here))
    return damped_step(normal, np.where(held, 0.0, gradient), damping)


def damped_step(normal: np.ndarray, gradient: np.ndarray, damping: float) -> np.ndarray:
    """Newton's step (free,), damped as Marquardt does. normal: (free, free)."""
    return np.linalg.solve(normal + damping * np.diag(np.diag(normal)), -gradient)
