"""A parameter: its name, unit, meaning and search range."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

TYPICAL_FRACTION = 0.1  # of its range, within which half of an amplitude's values lie


@dataclass(frozen=True)
class Parameter:
    """A parameter of an effect.

    A search varies the exponent chi in [0, 1]. If low > 0, the value is P = low (high /
    low)^chi (Eq. 3). Otherwise it is P = low + (high - low) chi^root, which is linear
    by default.

    Parameters
    ----------
    name, unit, meaning : str
        For the user.
    low, high : float
        Search range, in `unit`.
    start : float
        Initial value of a search.
    symbol : str
        Symbol in the paper, or empty.
    length_power : int
        Power of the segment length that turns the paper's value per mass point into a
        property of the material (see `String.material`).
    root : int
        Exponent of chi if `low` is not positive.
    is_lower_bound : bool
        Whether the data only bound the parameter from below.
    min_amplitude : float
        For an amplitude: a nonzero value below this has another physical cause.
    typical_size : float
        For an amplitude: distance from the start within which half of its values lie
        in practice; by default a tenth of the range on one side of the start.
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
    min_amplitude: float = 0.0
    typical_size: float = 0.0

    def __post_init__(self) -> None:
        """Set the default of `typical_size`."""
        if not self.typical_size:
            reach = max(self.high - self.start, self.start - self.low)
            object.__setattr__(self, "typical_size", TYPICAL_FRACTION * reach)

    def value(self, chi: np.ndarray) -> np.ndarray:
        """Return the values at exponents chi in [0, 1], in any shape."""
        if self.low > 0:
            return self.low * (self.high / self.low) ** np.asarray(chi)
        return self.low + (self.high - self.low) * np.asarray(chi) ** self.root

    def chi(self, value: np.ndarray) -> np.ndarray:
        """Return the exponents of values, clipped to [0, 1]: the inverse of `value`."""
        value = np.asarray(value, dtype=float)
        if self.low > 0:
            ratio = np.maximum(value, 1e-300) / self.low
            position = np.log(ratio) / np.log(self.high / self.low)
        else:
            share = (value - self.low) / (self.high - self.low)
            position = np.maximum(share, 0.0) ** (1 / self.root)
        return np.clip(position, 0.0, 1.0)

    def relative_size(self, chi: np.ndarray) -> np.ndarray:
        """Return distances of values from the start over the typical size."""
        return (self.value(chi) - self.start) / self.typical_size

    def slope(self, chi: np.ndarray) -> np.ndarray:
        """Return the derivative of `value` with respect to chi."""
        if self.low > 0:
            return np.log(self.high / self.low) * self.value(chi)
        power = np.asarray(chi) ** (self.root - 1)
        return (self.high - self.low) * self.root * power


def parameter_values(parameters: Sequence[Parameter], chi: np.ndarray) -> np.ndarray:
    """Return parameter values at exponents (..., P)."""
    columns = [p.value(chi[..., i]) for i, p in enumerate(parameters)]
    return np.stack(columns, axis=-1)


def parameter_exponents(
    parameters: Sequence[Parameter], values: np.ndarray
) -> np.ndarray:
    """Return exponents of parameter values (..., P), within [0, 1]."""
    columns = [p.chi(values[..., i]) for i, p in enumerate(parameters)]
    return np.stack(columns, axis=-1)


def parameter_slopes(parameters: Sequence[Parameter], chi: np.ndarray) -> np.ndarray:
    """Return derivatives of parameter values with respect to exponents (..., P)."""
    columns = [p.slope(chi[..., i]) for i, p in enumerate(parameters)]
    return np.stack(columns, axis=-1)
