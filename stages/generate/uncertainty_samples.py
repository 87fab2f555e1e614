"""Samples of what is uncertain in a cast: string, arm and simulation error."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.special import ndtri

from stringcast.data.estimates import Estimate
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import parameter_values

# draws (samples, quantities) numbers between 0 and 1
DrawUniforms = Callable[[np.random.Generator, int, int], np.ndarray]
SmallNumber = Annotated[float, Field(ge=0, le=0.1)]


@dataclass(frozen=True)
class PlanningUncertainty:
    """Uncertainty of arm and simulation.

    Parameters
    ----------
    amplitude : relative error of a joint's speed between trials, one sigma
    lag : largest delay of the joints behind their commands [s]
    tip : error of the simulated tip before the first cast, one sigma of a
        coordinate [m]
    """

    amplitude: SmallNumber
    lag: SmallNumber
    tip: SmallNumber


@dataclass(frozen=True)
class UncertaintySamples:
    """Samples of the uncertain quantities.

    Parameters
    ----------
    values : (K, P) values of the model's parameters
    amplitude : (K, J) relative error of the joint rotations
    lag : (K,) delay of the joints [s]
    tip_sigma : error of the simulated tip, one sigma of a coordinate [m]
    tip_normal : (K, 2) the tip's error in units of its sigma
    """

    values: np.ndarray
    amplitude: np.ndarray
    lag: np.ndarray
    tip_sigma: float
    tip_normal: np.ndarray

    def __len__(self) -> int:
        """Count the samples."""
        return len(self.values)

    def select(self, chosen: slice | np.ndarray) -> UncertaintySamples:
        """Select samples by their numbers."""
        return UncertaintySamples(
            self.values[chosen],
            self.amplitude[chosen],
            self.lag[chosen],
            self.tip_sigma,
            self.tip_normal[chosen],
        )


def independent_uniforms(
    rng: np.random.Generator, count: int, quantities: int
) -> np.ndarray:
    """Draw independent numbers between 0 and 1, (count, quantities)."""
    return rng.random((count, quantities))


def stratified_uniforms(
    rng: np.random.Generator, count: int, quantities: int
) -> np.ndarray:
    """Draw one number from each of `count` equal parts of the range.

    Latin hypercube sampling (McKay, Beckman and Conover, Technometrics 21, 239, 1979):
    means over the samples vary less than those of independent ones.

    Returns
    -------
    (count, quantities) array
        Numbers between 0 and 1.
    """
    parts = np.argsort(rng.random((count, quantities)), axis=0)
    return (parts + rng.random((count, quantities))) / count


def sample_uncertainty(
    model: Model,
    estimate: Estimate | None,
    uncertainty: PlanningUncertainty,
    count: int,
    rng: np.random.Generator,
    draw_uniforms: DrawUniforms = independent_uniforms,
    least_tip_error: float = 0.0,
) -> UncertaintySamples:
    """Sample the string, the arm's errors and the simulation's error.

    Strings are samples of the estimate. Before the first estimate, every exponent
    within a parameter's range is equally likely (Eq. 3), except that known parameters
    keep their values. With an estimate, the simulation's error is the model error that
    it states.

    Parameters
    ----------
    model : Model
        The string with its parameters, and the arm.
    estimate : Estimate or None
        Latest estimate of the string.
    uncertainty : PlanningUncertainty
        Uncertainty of arm and simulation.
    count : int
        Number of samples K.
    rng : numpy.random.Generator
        Source of randomness.
    draw_uniforms : callable
        Draws numbers between 0 and 1, such as `independent_uniforms`.
    least_tip_error : float
        Least error of the simulated tip with an estimate, one sigma of a coordinate
        [m]; slow trials show less of the error than a cast.

    Returns
    -------
    UncertaintySamples
        K samples.
    """
    joints = len(model.arm.links)
    uniforms = draw_uniforms(rng, count, joints + 3)
    amplitude = uncertainty.amplitude * ndtri(uniforms[:, :joints])
    lag = uncertainty.lag * uniforms[:, joints]
    tip_sigma = uncertainty.tip
    if estimate is not None:
        tip_sigma = max(estimate.model_error_m, least_tip_error)
    tip_normal = ndtri(uniforms[:, joints + 1 :])
    if estimate is None:
        chi = draw_uniforms(rng, count, len(model.names))
        values = parameter_values(model.parameters, chi)
        for number, name in enumerate(model.names):
            if name in model.start_values:
                values[:, number] = model.start_values[name]
    else:
        possible = [model.values(row) for row in estimate.draws.to_dict("records")]
        place = draw_uniforms(rng, count, 1)[:, 0]
        values = np.stack(possible)[(place * len(possible)).astype(int)]
    return UncertaintySamples(values, amplitude, lag, tip_sigma, tip_normal)
