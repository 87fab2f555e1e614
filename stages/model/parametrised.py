"""Base class of strings and models: parameters with qualified names."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from functools import cached_property

import numpy as np

from stringcast.stages.model.effect import Effect
from stringcast.stages.model.parameter import (
    Parameter,
    parameter_exponents,
    parameter_values,
)


class Parametrised:
    """An object with parameters: a string or a model."""

    @property
    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """All parameters, with qualified names."""

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Qualified names of the parameters."""
        return tuple(p.name for p in self.parameters)

    def values_of(
        self, effect: type[Effect], values: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Return an effect's own values by name, from all values (..., P)."""
        parameters = {}
        for parameter in effect.parameters:
            place = self.names.index(effect.qualified_name(parameter))
            parameters[parameter.name] = values[..., place]
        return parameters

    def values(self, named: Mapping[str, float]) -> np.ndarray:
        """Return values in the order of `parameters`, (P,).

        A parameter that is not named takes its start value.
        """
        return np.array([named.get(p.name, p.start) for p in self.parameters])

    def values_at(self, chi: np.ndarray) -> dict[str, float]:
        """Return values by name at exponents (P,)."""
        values = parameter_values(self.parameters, chi)
        return dict(zip(self.names, values.tolist(), strict=True))

    def exponents_of_values(self, named: Mapping[str, float]) -> np.ndarray:
        """Return exponents (P,) of values by name, clipped to this object's ranges.

        A parameter that is not named takes its start value.
        """
        return parameter_exponents(self.parameters, self.values(named))
