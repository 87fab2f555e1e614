"""A parameter: what it is called, measured in, and where it is sought."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Parameter:
    """A parameter of an effect.

    Ranges with low > 0 are searched in the exponential form of Eq. 3, P = low (high /
    low)^chi; others evenly in a root of the distance from low, P = low + (high - low)
    chi^root: by default linearly.

    Parameters
    ----------
    name, unit, meaning : str
        What it is.
    low, high : float
        Search range, in `unit`.
    start : float
        Value before anything is known.
    symbol : str
        The paper's, empty if it has none.
    length_power : int
        Power of the segment length that turns the paper's value per mass point into a
        property of the material (see `String.material`).
    root : int
        Root in which the range is searched evenly.
    is_lower_bound : bool
        What is fitted is the least that it may be.
    least : float
        Of an amplitude: one that is smaller, but there, is not what its name says.
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
    least: float = 0.0

    def value(self, chi: np.ndarray) -> np.ndarray:
        """Return the values at exponents chi in [0, 1] (Eq. 3). Any shape."""
        if self.low > 0:
            return self.low * (self.high / self.low) ** np.asarray(chi)
        return self.low + (self.high - self.low) * np.asarray(chi) ** self.root

    def chi(self, value: np.ndarray) -> np.ndarray:
        """Return the exponents of values, clipped to [0, 1]. Any shape.

        The inverse of `value`.
        """
        value = np.asarray(value, dtype=float)
        if self.low > 0:
            ratio = np.maximum(value, 1e-300) / self.low
            position = np.log(ratio) / np.log(self.high / self.low)
        else:
            share = (value - self.low) / (self.high - self.low)
            position = np.maximum(share, 0.0) ** (1 / self.root)
        exponents: np.ndarray = np.clip(position, 0.0, 1.0)
        return exponents

    def slope(self, chi: np.ndarray) -> np.ndarray:
        """Return the slope of values with exponents in [0, 1]. Any shape."""
        if self.low > 0:
            slope: np.ndarray = np.log(self.high / self.low) * self.value(chi)
            return slope
        power = np.asarray(chi) ** (self.root - 1)
        return (self.high - self.low) * self.root * power


def parameter_values(parameters: Sequence[Parameter], chi: np.ndarray) -> np.ndarray:
    """Return parameter values at exponents (..., P), Eq. 3."""
    columns = [p.value(chi[..., i]) for i, p in enumerate(parameters)]
    return np.stack(columns, axis=-1)


def parameter_exponents(
    parameters: Sequence[Parameter], values: np.ndarray
) -> np.ndarray:
    """Return exponents of parameter values (..., P), within [0, 1]."""
    columns = [p.chi(values[..., i]) for i, p in enumerate(parameters)]
    return np.stack(columns, axis=-1)


def parameter_slopes(parameters: Sequence[Parameter], chi: np.ndarray) -> np.ndarray:
    """Return slopes of parameter values with exponents (..., P)."""
    columns = [p.slope(chi[..., i]) for i, p in enumerate(parameters)]
    return np.stack(columns, axis=-1)
