"""What strings and models share: parameters with qualified names."""

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
    """A string or a model: what has parameters."""

    @property
    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """All of them, with qualified names."""

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Qualified names of the parameters."""
        return tuple(p.name for p in self.parameters)

    def values_of(
        self, effect: type[Effect], values: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Return an effect's parameters by their own names, (...), of all (..., P)."""
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
        """Return exponents (P,) of values by name, each within its range here.

        So values are carried to a model with other ranges. A parameter that is not
        named takes its start value.
        """
        return parameter_exponents(self.parameters, self.values(named))
