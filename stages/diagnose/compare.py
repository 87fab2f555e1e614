"""Theories on trials they have not seen."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from stages.diagnose.evidence import Evidence
from stages.diagnose.fit import Fit, fitted, newton

BLOCK = 0.05  # [s] of time taken as one independent piece
AGAIN = 3  # steps of a fit without one trial


@dataclass(frozen=True)
class HeldOut:
    """A fit, and what it says of each trial when that trial is left out. residual: (N,) over sigma, each trial's
    from the parameters fitted without it, chi: (K, P)."""

    fit: Fit
    chi: np.ndarray
    residual: np.ndarray
    trial: np.ndarray

    @cached_property
    def costs(self) -> np.ndarray:
        """Half the sum of squares of each trial, (K,)."""
        return 0.5 * np.bincount(self.trial, self.residual**2)


def held_out(evidence: Evidence, fit: Fit) -> HeldOut:
    """Each trial left out in turn, the others fitted anew."""
    numbers = range(len(evidence.cases))
    chi = np.stack([_without(evidence, fit, k) for k in numbers])
    seen = [evidence.only([k]).residuals(fit.theory.model, chi[k][None])[0] for k in numbers]
    return HeldOut(fit, chi, np.concatenate(seen), evidence.trial)


def _without(evidence: Evidence, fit: Fit, left_out: int) -> np.ndarray:
    """(P,) fitted to the other trials.

    The first step is Gauss and Newton's with the slopes at hand: it takes what only that trial knew back to where it
    was expected. Then a few more.
    """
    kept = evidence.trial != left_out
    start = newton(fit.theory, fit.chi, fit.residual[kept], fit.slopes[kept], damping=0.0)
    others = evidence.only([k for k in range(len(evidence.cases)) if k != left_out])
    return fitted(others, [fit.theory], [start], AGAIN)[0].chi


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
