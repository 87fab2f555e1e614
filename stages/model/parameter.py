"""A parameter: what it is called, measured in, and where it is sought; and what has
parameters.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect.

    low, high: search range, in `unit`. start: value before anything is known. symbol:
    the paper's, empty if it has none. Ranges with low > 0 are searched in the
    exponential form of Eq. 3, P = low (high / low)^chi; others evenly in a root of the
    distance from low, P = low + (high - low) chi^root: by default linearly. per_length:
    power of the segment length that turns the paper's value per mass point into a
    property of the material (see `stages.model.string.String.material`). at_least: what
    is fitted is the least that it may be.
    """

    name: str
    unit: str
    meaning: str
    low: float
    high: float
    start: float
    symbol: str = ""
    length_power: int = 0
    root: int = 1
    is_lower_bound: bool = False

    def value(self, chi: np.ndarray) -> np.ndarray:
        """Values at exponents chi in [0, 1] (Eq. 3). Any shape."""
        if self.low > 0:
            return self.low * (self.high / self.low) ** np.asarray(chi)
        return self.low + (self.high - self.low) * np.asarray(chi) ** self.root

    def chi(self, value: np.ndarray) -> np.ndarray:
        """Exponents of values; the inverse of `value`, clipped to [0, 1]. Any shape."""
        value = np.asarray(value, dtype=float)
        if self.low > 0:
            position = np.log(np.maximum(value, 1e-300) / self.low) / np.log(
                self.high / self.low
            )
        else:
            position = np.maximum((value - self.low) / (self.high - self.low), 0.0) ** (
                1 / self.root
            )
        return np.clip(position, 0.0, 1.0)

    def slope(self, chi: np.ndarray) -> np.ndarray:
        """The slope of values with exponents in [0, 1]. Any shape."""
        if self.low > 0:
            return np.log(self.high / self.low) * self.value(chi)
        return (self.high - self.low) * self.root * np.asarray(chi) ** (self.root - 1)


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

    def values(self, named: Mapping[str, float]) -> np.ndarray:
        """(P,) values in the order of `parameters`; a missing name takes its start
        value.
        """
        return np.array([named.get(p.name, p.start) for p in self.parameters])


def parameter_values(parameters: Sequence[Parameter], chi: np.ndarray) -> np.ndarray:
    """Parameter values at exponents (..., P), Eq. 3."""
    return np.stack([p.value(chi[..., i]) for i, p in enumerate(parameters)], axis=-1)


def parameter_exponents(
    parameters: Sequence[Parameter], values: np.ndarray
) -> np.ndarray:
    """Exponents of parameter values (..., P), within [0, 1]."""
    return np.stack([p.chi(values[..., i]) for i, p in enumerate(parameters)], axis=-1)


def parameter_slopes(parameters: Sequence[Parameter], chi: np.ndarray) -> np.ndarray:
    """Slopes of parameter values with exponents (..., P), likewise."""
    return np.stack([p.slope(chi[..., i]) for i, p in enumerate(parameters)], axis=-1)
