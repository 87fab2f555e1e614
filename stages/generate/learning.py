"""Expected information of a cast: how well the tip of the next cast can be predicted.

For each motion, the simulated strings are fitted as linear functions of the parameters'
exponents (with the prior of `least_squares`). Observing a motion adds its Fisher
information about the exponents. This reduces the variance of the tip predicted on a
motion of interest (c-optimal design).

Reference: A. Atkinson, A. Donev and R. Tobias, Optimum Experimental Designs, 2007,
chapter 10.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stringcast.stages.generate.curves import Curves
from stringcast.stages.generate.hit_probability import (
    CastTask,
    midpoint_tip_path,
    simulate_motions,
)
from stringcast.stages.generate.uncertainty_samples import UncertaintySamples
from stringcast.stages.model.parameter import parameter_exponents

OBSERVED_PLACES = 4  # points on the string that stand for all observed points
# ticks between observations; simulation error is correlated in time, so that denser
# ones add no information
TICK_STRIDE = 4
MIN_SIGMA_M = 1e-3  # error of observation and simulation together
RIDGE = 1e-3  # share of the exponents' variance; stabilises a fit to few samples


def predictive_sd(
    task: CastTask, curves: Curves, samples: UncertaintySamples, interest: int
) -> np.ndarray:
    """Predict the uncertainty of the tip at the target after each of several motions.

    Parameters
    ----------
    task : CastTask
        Model, target and obstacles.
    curves : Curves
        M motions.
    samples : UncertaintySamples
        K samples of the uncertain quantities.
    interest : int
        Index of the motion whose tip is predicted.

    Returns
    -------
    (M,) array
        Standard deviation of the tip [m]; infinite for a motion on which a simulation
        fails.
    """
    sigma = max(MIN_SIGMA_M, samples.tip_sigma)
    task = replace(task, mesh=None)  # the same for all strings
    # without arm and tip errors: with few samples they would correlate with parameters
    strings = replace(
        samples,
        amplitude=0 * samples.amplitude,
        lag=0 * samples.lag,
        tip_normal=0 * samples.tip_normal,
    )
    chi = parameter_exponents(task.model.parameters, samples.values)
    # (K, P), parameters that vary
    varying = chi[:, np.ptp(chi, axis=0) > 0]
    exponents = varying - varying.mean(axis=0)
    ridge = RIDGE * np.eye(exponents.shape[1])
    precision = np.linalg.inv(exponents.T @ exponents / len(strings) + ridge)

    # tip of each sample (K, 2) [m] when the median sample's is nearest to the target
    interesting = curves.select(np.array([interest]))
    points = simulate_motions(task, interesting, strings).points
    path = midpoint_tip_path(points[:, :, -1])
    distance = task.target.distance_to_centre(path)
    typical = np.argsort(distance.min(axis=1), kind="stable")[len(path) // 2]
    tip_slopes = _jacobian(exponents, path[:, int(np.argmin(distance[typical]))])

    result = np.full(len(curves.duration), np.inf)
    for number in range(len(curves.duration)):
        motion = curves.select(np.array([number]))
        points = simulate_motions(task, motion, strings).points
        if np.isfinite(points).all():
            from_tip = points[:, ::TICK_STRIDE, ::-1]
            observed = from_tip[:, :, :: points.shape[2] // OBSERVED_PLACES]
            slopes = _jacobian(exponents, observed.reshape(len(strings), -1)) / sigma
            covariance = np.linalg.inv(precision + slopes @ slopes.T)
            result[number] = np.sqrt(np.trace(tip_slopes.T @ covariance @ tip_slopes))
    return result


def _jacobian(exponents: np.ndarray, observed: np.ndarray) -> np.ndarray:
    """Fit slopes (P, Y) of observed quantities (K, Y) over the exponents (K, P)."""
    ridge = RIDGE * len(exponents) * np.eye(exponents.shape[1])
    centred = observed - observed.mean(axis=0)
    return np.linalg.solve(exponents.T @ exponents + ridge, exponents.T @ centred)
