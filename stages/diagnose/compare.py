"""Theories on trials they have not seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stringcast.stages.diagnose.evidence import Evidence
from stringcast.stages.diagnose.fit import Fit, fitted, newton_step, ranked, shortened
from stringcast.stages.diagnose.predictive import cost_of_unseen
from stringcast.stages.inference.likelihood import time_blocks

SHOWN = 10.0  # of the log-likelihood that a cause must gain on other trials to be shown by them
AGAIN = 3  # steps of a fit without one trial


@dataclass(frozen=True)
class HeldOut:
    """A fit, and what it says of each trial when that trial is left out. chi: (K, P) fitted without it. spent: what
    these fits cost, (K,). costs: minus the log-likelihood of the trial itself, (K,)."""

    fit: Fit
    chi: np.ndarray
    spent: np.ndarray
    costs: np.ndarray


def held_out(evidence: Evidence, fit: Fit, plain: HeldOut | None = None) -> HeldOut:
    """Each trial left out in turn, the others fitted anew.

    plain: the same without causes. A cause that the other trials do not show, or with which the trial cannot be
    simulated where they put it, is absent in what they predict.
    """
    every = without_each(evidence, fit)
    chi, spent = [fits[0].chi for fits in every], [fits[0].cost for fits in every]
    costs = [cost_of_unseen(evidence.only([k]), fits) for k, fits in enumerate(every)]
    for k in range(len(every)):
        if plain is not None and (plain.spent[k] < spent[k] + SHOWN or np.isinf(costs[k])):
            chi[k] = fit.theory.carried(dict(zip(plain.fit.theory.model.names, plain.chi[k], strict=True)))
            spent[k], costs[k] = plain.spent[k], plain.costs[k]
    return HeldOut(fit, np.stack(chi), np.array(spent), np.array(costs))


def without_each(evidence: Evidence, fit: Fit) -> list[list[Fit]]:
    """Fits to all trials but one, for each trial, the best first."""
    return [_without(evidence, fit, k) for k in range(len(evidence.cases))]


def _without(evidence: Evidence, fit: Fit, left_out: int) -> list[Fit]:
    """Two fits to the other trials, the better one first; one where these clearly prefer it.

    The first step is Gauss and Newton's with the slopes at hand: it takes what only that trial knew back to where it
    was expected. Then a few more; and from where the fit to all is, if that first step led astray. What that trial
    prefers counts only where the others hardly mind.
    """
    kept = evidence.trial != left_out
    start = fit.chi.copy()
    start[fit.theory.free] += shortened(
        newton_step(fit.theory, fit.chi, fit.residual[kept], fit.slopes[kept], damping=0.0)
    )
    others = evidence.only([k for k in range(len(evidence.cases)) if k != left_out])
    fits = ranked(fitted(others, [fit.theory] * 2, [np.clip(start, 0, 1), fit.chi], AGAIN))
    return [each for each in fits if each.cost < fits[0].cost + SHOWN]


def blocks(evidence: Evidence) -> np.ndarray:
    """Number of the piece of time of each residual, (N,), counted through all trials."""
    return time_blocks(evidence.cases)


def moved(evidence: Evidence, one: Fit, other: Fit) -> np.ndarray:
    """How far two fits are apart where they are most, in standard deviations, trial by trial, (K,)."""
    apart = np.linalg.norm((one.residual - other.residual).reshape(-1, 2), axis=1)
    return np.array([apart[evidence.trial[::2] == k].max() for k in range(len(evidence.cases))])
