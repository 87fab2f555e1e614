"""Hypotheses: a base model and the causes that are active in addition to it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from stringcast.stages.inference.solver import FIRST_DIFFERENCE
from stringcast.stages.model.effect import Effect, acts_abruptly, amplitude_parameters
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import Parameter

# With this step, dry friction that slips at small curvatures has a tip error of 0.1 to
# 0.8 mm
ABRUPT_STEP_S = 1e-3


@dataclass(frozen=True)
class Hypothesis:
    """A base model with causes in addition to its own effects."""

    base: Model
    causes: tuple[type[Effect], ...] = ()

    @cached_property
    def model(self) -> Model:
        """The base model with all causes, with time steps short enough for them."""
        model = self.base.with_effects(*self.causes)
        if not any(acts_abruptly(cause) for cause in self.causes):
            return model
        step_s = min(model.string.largest_step, ABRUPT_STEP_S)
        return replace(model, string=replace(model.string, largest_step=step_s))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The fitted parameters: all P of the model."""
        return self.model.parameters

    @property
    def cause_names(self) -> tuple[str, ...]:
        """The names of the causes."""
        return tuple(cause.name for cause in self.causes)

    def with_cause(self, cause: type[Effect]) -> Hypothesis:
        """Add a cause to the active ones."""
        return replace(self, causes=(*self.causes, cause))

    def without_cause(self, cause: type[Effect]) -> Hypothesis:
        """Remove a cause from the active ones."""
        others = tuple(other for other in self.causes if other is not cause)
        return replace(self, causes=others)

    def parameter_indices(
        self,
        cause: type[Effect],
        parameters: Sequence[Parameter],
    ) -> list[int]:
        """Find the indices of a cause's parameters among all parameters."""
        names = self.model.names
        return [names.index(cause.qualified_name(p)) for p in parameters]

    def amplitude_indices(self, cause: type[Effect]) -> list[int]:
        """Find the indices of a cause's amplitudes among all parameters."""
        return self.parameter_indices(cause, amplitude_parameters(cause))

    @property
    def all_amplitude_indices(self) -> list[int]:
        """The indices of all causes' amplitudes among all parameters."""
        indices: list[int] = []
        for cause in self.causes:
            indices += self.amplitude_indices(cause)
        return indices

    @cached_property
    def base_indices(self) -> list[int]:
        """The indices of the base model's parameters among all parameters."""
        return [self.model.names.index(name) for name in self.base.names]

    def exponents_from(self, known: Mapping[str, float]) -> np.ndarray:
        """Collect exponents (P,) by name; unknown ones are those of an absent cause."""
        absent = self.model.exponents_of_values({})
        pairs = zip(self.model.names, absent, strict=True)
        return np.array([known.get(name, start) for name, start in pairs])

    def widths_from(self, known: Mapping[str, float]) -> np.ndarray:
        """Collect difference widths (P,) by name; unknown ones have the default."""
        names = self.model.names
        return np.array([known.get(name, FIRST_DIFFERENCE) for name in names])
