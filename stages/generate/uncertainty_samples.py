"""Uncertainty of the next cast, as draws: of the string, of how the arm follows, of the
simulation's error.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from stringcast.data.artifacts import Estimate
from stringcast.stages.model.model import Model

SmallNumber = Annotated[float, Field(ge=0, le=0.1)]


@dataclass(frozen=True)
class PlanningUncertainty:
    """Uncertainty beside the string's.

    amplitude: of a joint's relative speed from one trial to the next, one sigma. lag:
    how late joints follow their commands at most [s]. tip: error of the simulation at
    the tip before a trial tells it, one sigma of a coordinate [m].
    """

    amplitude: SmallNumber
    lag: SmallNumber
    tip: SmallNumber


@dataclass(frozen=True)
class UncertaintySamples:
    """Draws of what may be so. values: (K, P) of the model's parameters. amplitude: (K,
    J) what joints turn more than commanded, as a share. lag: (K,) [s]. off: (K, 2) of
    the simulated tip [m].
    """

    values: np.ndarray
    amplitude: np.ndarray
    lag: np.ndarray
    tip_error: np.ndarray

    def __len__(self) -> int:
        """How many."""
        return len(self.values)

    def select(self, chosen: slice | np.ndarray) -> UncertaintySamples:
        """Some of the draws, in the order of their numbers."""
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
    """Draws of the string, of how the arm follows, and of the simulation's error;
    `count` of them.

    Strings come from what an estimate's trials leave possible; before the first, every
    exponent within a parameter's range is as likely as another (Eq. 3), but for
    parameters that are known. Once there is an estimate, the distance that it leaves
    between simulated and measured strings says how far the simulation is off.
    """
    amplitude = uncertainty.amplitude * rng.standard_normal(
        (count, len(model.arm.links))
    )
    lag = rng.uniform(0, uncertainty.lag, count)
    tip = (
        uncertainty.tip
        if estimate is None
        else float(estimate.fit["rms_after"].iloc[0])
    )
    off = tip * rng.standard_normal((count, 2))
    if estimate is None:
        columns = [p.value(rng.uniform(0, 1, count)) for p in model.parameters]
        known = [model.start_values.get(name) for name in model.names]
        values = [
            column if x is None else np.full(count, x)
            for column, x in zip(columns, known, strict=True)
        ]
        return UncertaintySamples(np.stack(values, axis=-1), amplitude, lag, off)
    # any as likely as another
    every = np.stack([model.values(row) for row in estimate.draws.to_dict("records")])
    return UncertaintySamples(
        every[rng.integers(0, len(every), count)], amplitude, lag, off
    )
