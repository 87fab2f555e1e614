"""Samples of what is uncertain in a cast: string, arm and simulation error."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from stringcast.data.artifacts import Estimate
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import parameter_values

SmallNumber = Annotated[float, Field(ge=0, le=0.1)]


@dataclass(frozen=True)
class PlanningUncertainty:
    """Uncertainty of arm and simulation.

    Parameters
    ----------
    amplitude : relative error of a joint's speed between trials, one sigma
    lag : largest delay of the joints behind their commands [s]
    tip : error of the simulated tip before the first trial, one sigma of a
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
    amplitude : (K, J) share by which joints turn more than commanded
    lag : (K,) delay of the joints [s]
    tip_error : (K, 2) error of the simulated tip [m]
    """

    values: np.ndarray
    amplitude: np.ndarray
    lag: np.ndarray
    tip_error: np.ndarray

    def __len__(self) -> int:
        """Count the samples."""
        return len(self.values)

    def select(self, chosen: slice | np.ndarray) -> UncertaintySamples:
        """Select samples by their numbers."""
        return UncertaintySamples(
            self.values[chosen],
            self.amplitude[chosen],
            self.lag[chosen],
            self.tip_error[chosen],
        )


def sample_uncertainty(
    model: Model,
    estimate: Estimate | None,
    uncertainty: PlanningUncertainty,
    count: int,
    rng: np.random.Generator,
) -> UncertaintySamples:
    """Sample the string, how the arm follows, and the simulation's error.

    Strings are samples of the estimate. Before the first estimate, every exponent
    within a parameter's range is equally likely (Eq. 3), except that known parameters
    keep their values. The simulation's error is then the model's, as the estimate
    states it.

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

    Returns
    -------
    UncertaintySamples
        K independent samples.
    """
    amplitude = rng.standard_normal((count, len(model.arm.links)))
    amplitude *= uncertainty.amplitude
    lag = rng.uniform(0, uncertainty.lag, count)
    tip_sigma = uncertainty.tip
    if estimate is not None:
        tip_sigma = estimate.model_error_m
    tip_error = tip_sigma * rng.standard_normal((count, 2))
    if estimate is None:
        chi = rng.uniform(0, 1, (len(model.names), count)).T
        values = parameter_values(model.parameters, chi)
        for number, name in enumerate(model.names):
            if name in model.start_values:
                values[:, number] = model.start_values[name]
    else:
        possible = [model.values(row) for row in estimate.draws.to_dict("records")]
        values = np.stack(possible)[rng.integers(0, len(possible), count)]
    return UncertaintySamples(values, amplitude, lag, tip_error)
