"""Expected information of a cast: how well, after it, the tip of the next one would be
predicted at the target.

To first order: each motion's strings, under the draws, are fitted as linear in the
exponents of the parameters (with the prior of `least_squares`); what is seen of a
motion narrows the exponents by its Fisher information, and these in turn the prediction
of the tip on a motion of interest (c-optimal design: Atkinson, Donev and Tobias 2007,
Optimum Experimental Designs, chapter 10).
"""

from __future__ import annotations

import numpy as np

from stringcast.stages.common import rms
from stringcast.stages.generate.chance import Task, between, simulated
from stringcast.stages.generate.curves import Curves
from stringcast.stages.generate.draws import Draws

PLACES = 4  # on the string, from its tip, that stand for all that are seen
EVERY = 4  # ticks: a simulation's error lasts, so that nearer looks are no new evidence
LEAST = 1e-3  # [m] what is seen and simulated is never surer
RIDGE = 1e-3  # of the exponents' variance: keeps a fit to few draws in hand


def predictive_sd(
    task: Task, curves: Curves, draws: Draws, interest: int
) -> np.ndarray:
    """Predictive standard deviation of the tip at the target on the motion of interest
    after each motion, (M,) [m].

    curves: M motions. interest: the number of one. Infinite for a motion on which a
    simulation fails.
    """
    sigma = max(LEAST, rms(draws.off))
    # Of the string alone: by few draws, what is chance would look like what the string
    # does.
    draws = Draws(
        draws.values, *(0 * part for part in (draws.amplitude, draws.lag, draws.off))
    )
    chi = np.stack(
        [p.chi(draws.values[:, i]) for i, p in enumerate(task.model.parameters)],
        axis=-1,
    )
    # (K, P), of parameters that draws do not share
    exponents = (chi - chi.mean(axis=0))[:, np.ptp(chi, axis=0) > 0]
    covariance = exponents.T @ exponents / len(draws) + RIDGE * np.eye(
        exponents.shape[1]
    )
    _, points = simulated(task.model, curves.only(np.array([interest])), draws)
    # where each draw's tip is when the middle one is nearest to the target, (K, 2) [m]
    way = between(points[:, :, -1])
    away = task.target.distance_to_centre(way)
    typical = int(np.argsort(away.min(axis=1), kind="stable")[len(way) // 2])
    matters = _slopes(exponents, way[:, int(np.argmin(away[typical]))])
    result = np.full(len(curves.duration), np.inf)
    for number in range(len(curves.duration)):
        _, points = simulated(task.model, curves.only(np.array([number])), draws)
        if np.isfinite(points).all():
            seen = points[:, ::EVERY, ::-1][:, :, :: points.shape[2] // PLACES].reshape(
                len(draws), -1
            )
            slopes = _slopes(exponents, seen) / sigma
            after = np.linalg.inv(np.linalg.inv(covariance) + slopes @ slopes.T)
            result[number] = np.sqrt(np.trace(matters.T @ after @ matters))
    return result


def _slopes(exponents: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """(P, Y) slopes of what is seen (K, Y) with the exponents (K, P)."""
    normal = exponents.T @ exponents + RIDGE * len(exponents) * np.eye(
        exponents.shape[1]
    )
    return np.linalg.solve(normal, exponents.T @ (seen - seen.mean(axis=0)))
