"""How probable a trial is to fits that were made to others.

What these leave open of the string may be anything that they allow: a trial that swings so hard that a thousandth of a
stiffness sends it elsewhere would refute every theory, the true one too. Causes do not follow: what others say of them
is what is asked.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import log_softmax, logsumexp

from stringcast.stages.diagnose.evidence import LOST, Evidence
from stringcast.stages.diagnose.fit import Fit, damped_step, fitted, shortened
from stringcast.stages.diagnose.theory import Theory

FOLLOWS = 4  # steps by which the string's parameters follow a trial
DAMPINGS = (0.0, 1e-2, 1.0)  # of each
LITTLE = 1.0  # of the log-likelihood that a further step must gain


def cost_of_unseen(trial: Evidence, fits: Sequence[Fit]) -> float:
    """Minus the log-likelihood of a trial from fits to others, each as probable as these make it: where they leave
    something open, a plane that only one trial touched, say, the best of them alone foretells too much. Infinite where
    no simulation of it survives."""
    costs = np.array([_marginal(trial, _Allowed.by(fit)) for fit in fits])
    return -float(logsumexp(log_softmax([-fit.cost for fit in fits]) - costs))


@dataclass(frozen=True)
class _Allowed:
    """What a fit to other trials allows of the string's own parameters. theory: in which these alone are free. chi:
    (P,) as fitted. known: (free, free) inverse of their covariance, the causes as they are."""

    theory: Theory
    chi: np.ndarray
    known: np.ndarray

    @classmethod
    def by(cls, fit: Fit) -> _Allowed:
        theory = replace(fit.theory, causes=())
        own = np.isin(fit.theory.free, theory.free)
        return cls(theory, fit.chi, fit.normal[np.ix_(own, own)])

    def at(self, trial: Evidence, chi: np.ndarray) -> Fit:
        """The trial at exponents (P,), with slopes."""
        return fitted(trial, [self.theory], [chi], 0)[0]

    def costs(self, chi: np.ndarray, residual: np.ndarray) -> np.ndarray:
        """(C,) of exponents (C, P) with the trial's residual (C, N), and of how far they are from what was fitted."""
        away = (chi - self.chi)[:, self.theory.free]
        far = np.einsum("cp,pq,cq->c", away, self.known, away)
        return np.where(np.any(residual == LOST, axis=1), np.inf, 0.5 * np.sum(residual**2, axis=1) + 0.5 * far)

    def cost(self, here: Fit) -> float:
        """The same of one fit to the trial."""
        return float(self.costs(here.chi[None], here.residual[None])[0])

    def steps(self, here: Fit) -> np.ndarray:
        """Exponents (C, P) to which damped steps lead from a fit to the trial."""
        free = self.theory.free
        gradient = here.slopes.T @ here.residual + self.known @ (here.chi - self.chi)[free]
        both = self.curvature(here)
        tried = np.repeat(here.chi[None], len(DAMPINGS), axis=0)
        tried[:, free] += [shortened(damped_step(both, gradient, damping)) for damping in DAMPINGS]
        return np.clip(tried, 0, 1)

    def curvature(self, here: Fit) -> np.ndarray:
        """(free, free) of the cost."""
        return here.slopes.T @ here.slopes + self.known


def _marginal(trial: Evidence, allowed: _Allowed) -> float:
    """Minus the logarithm of the mean likelihood over what is allowed, about where it is most (Laplace)."""
    here = allowed.at(trial, allowed.chi)
    for _ in range(FOLLOWS):
        tried = allowed.steps(here)
        costs = allowed.costs(tried, trial.residuals(allowed.theory.model, tried))
        if not costs.min() < allowed.cost(here) - LITTLE:
            break
        here = allowed.at(trial, tried[np.argmin(costs)])
    room = np.linalg.slogdet(allowed.curvature(here))[1] - np.linalg.slogdet(allowed.known)[1]
    return allowed.cost(here) + 0.5 * float(room)
