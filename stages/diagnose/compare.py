"""Theories on trials they have not seen."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from stages.diagnose.evidence import Evidence
from stages.diagnose.fit import Fit, fitted, newton_step, shortened

BLOCK = 0.05  # [s] of time taken as one independent piece
SHOWN = 10.0  # of the log-likelihood that a cause must gain on other trials to be shown by them
AGAIN = 3  # steps of a fit without one trial


@dataclass(frozen=True)
class HeldOut:
    """A fit, and what it says of each trial when that trial is left out. residual: (N,) over sigma, each trial's
    from the parameters fitted without it, chi: (K, P). spent: cost of each of these fits, (K,)."""

    fit: Fit
    chi: np.ndarray
    residual: np.ndarray
    trial: np.ndarray
    spent: np.ndarray

    @cached_property
    def costs(self) -> np.ndarray:
        """Half the sum of squares of each trial, (K,)."""
        return 0.5 * np.bincount(self.trial, self.residual**2)


def held_out(evidence: Evidence, fit: Fit, plain: HeldOut | None = None) -> HeldOut:
    """Each trial left out in turn, the others fitted anew.

    plain: the same without causes. A cause that the other trials do not show is absent in what they predict.
    """
    numbers = range(len(evidence.cases))
    fits = [_without(evidence, fit, k) for k in numbers]
    chi, spent = [each.chi for each in fits], [each.cost for each in fits]
    for k in numbers:
        if plain is not None and plain.spent[k] < spent[k] + SHOWN:
            chi[k], spent[k] = fit.theory.carried(plain.fit.theory.named(plain.chi[k])), plain.spent[k]
    seen = [evidence.only([k]).residuals(fit.theory.model, chi[k][None])[0] for k in numbers]
    return HeldOut(fit, np.stack(chi), np.concatenate(seen), evidence.trial, np.array(spent))


def _without(evidence: Evidence, fit: Fit, left_out: int) -> Fit:
    """Fitted to the other trials.

    The first step is Gauss and Newton's with the slopes at hand: it takes what only that trial knew back to where it
    was expected. Then a few more; or from where the fit to all is, if that first step led astray.
    """
    kept = evidence.trial != left_out
    start = fit.chi.copy()
    start[fit.theory.free] += shortened(
        newton_step(fit.theory, fit.chi, fit.residual[kept], fit.slopes[kept], damping=0.0)
    )
    others = evidence.only([k for k in range(len(evidence.cases)) if k != left_out])
    both = fitted(others, [fit.theory] * 2, [np.clip(start, 0, 1), fit.chi], AGAIN)
    return min(both, key=lambda each: each.cost)


def blocks(evidence: Evidence) -> np.ndarray:
    """Number of the piece of time of each residual, (N,), counted through all trials."""
    pieces, first = [], 0
    for case in evidence.cases:
        _, own = np.unique(np.floor(case.times[case.frame] / BLOCK).astype(int), return_inverse=True)
        pieces.append(np.repeat(first + own, 2))
        first += own.max() + 1
    return np.concatenate(pieces)


def moved(evidence: Evidence, one: Fit, other: Fit) -> np.ndarray:
    """How far two fits are apart where they are most, in standard deviations, trial by trial, (K,)."""
    apart = np.linalg.norm((one.residual - other.residual).reshape(-1, 2), axis=1)
    return np.array([apart[evidence.trial[::2] == k].max() for k in range(len(evidence.cases))])
