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
from stringcast.stages.generate.curves import Curves
from stringcast.stages.generate.hit_probability import (
    CastTask,
    midpoint_tip_path,
    simulate_motions,
)
from stringcast.stages.generate.uncertainty_samples import UncertaintySamples

OBSERVED_PLACES = 4  # on the string, from its tip, that stand for all that are seen
# ticks: a simulation's error lasts, so that nearer looks are no new evidence
TICK_STRIDE = 4
MIN_SIGMA_M = 1e-3  # [m] what is seen and simulated is never surer
RIDGE = 1e-3  # of the exponents' variance: keeps a fit to few draws in hand


def predictive_sd(
    task: CastTask, curves: Curves, draws: UncertaintySamples, interest: int
) -> np.ndarray:
    """Predictive standard deviation of the tip at the target on the motion of interest
    after each motion, (M,) [m].

    curves: M motions. interest: the number of one. Infinite for a motion on which a
    simulation fails.
    """
    sigma = max(MIN_SIGMA_M, rms(draws.tip_error))
    # Of the string alone: by few draws, what is chance would look like what the string
    # does.
    draws = UncertaintySamples(
        draws.values,
        *(0 * part for part in (draws.amplitude, draws.lag, draws.tip_error)),
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
    _, points = simulate_motions(task.model, curves.select(np.array([interest])), draws)
    # where each draw's tip is when the middle one is nearest to the target, (K, 2) [m]
    way = midpoint_tip_path(points[:, :, -1])
    away = task.target.distance_to_centre(way)
    typical = int(np.argsort(away.min(axis=1), kind="stable")[len(way) // 2])
    matters = _jacobian(exponents, way[:, int(np.argmin(away[typical]))])
    result = np.full(len(curves.duration), np.inf)
    for number in range(len(curves.duration)):
        _, points = simulate_motions(
            task.model, curves.select(np.array([number])), draws
        )
        if np.isfinite(points).all():
            seen = points[:, ::TICK_STRIDE, ::-1][
                :, :, :: points.shape[2] // OBSERVED_PLACES
            ].reshape(len(draws), -1)
            slopes = _jacobian(exponents, seen) / sigma
            after = np.linalg.inv(np.linalg.inv(covariance) + slopes @ slopes.T)
            result[number] = np.sqrt(np.trace(matters.T @ after @ matters))
    return result


def _jacobian(exponents: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """(P, Y) slopes of what is seen (K, Y) with the exponents (K, P)."""
    normal = exponents.T @ exponents + RIDGE * len(exponents) * np.eye(
        exponents.shape[1]
    )
    return np.linalg.solve(normal, exponents.T @ (seen - seen.mean(axis=0)))
