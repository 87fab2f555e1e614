"""Invariants: properties of a law that an effect declares and tests check on samples.

`error` takes the law's arguments as arrays, one entry for each sample. It returns the
violation of the property relative to the law's size.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

LawArguments = Mapping[str, Any]
EvaluatedLaw = Callable[[LawArguments], np.ndarray]
TEST_ROTATION_RAD = 0.7
TEST_SHIFT = 0.37


class Invariant(ABC):
    """A property of a law.

    Attributes
    ----------
    law : str
        Name of the law.
    sentence : str
        The property in words.
    """

    law: str
    sentence: str

    @abstractmethod
    def error(self, law: EvaluatedLaw, arguments: LawArguments) -> float:
        """Return the violation by a law on samples, relative to the law's size."""


@dataclass(frozen=True)
class Equivariant(Invariant):
    """A law whose value changes in a known way with its arguments.

    Parameters
    ----------
    law, sentence : str
        As in `Invariant`.
    before : callable
        Changes the arguments.
    after : callable
        Changes the value accordingly.
    """

    law: str
    sentence: str
    before: Callable[[LawArguments], LawArguments]
    after: Callable[[np.ndarray, LawArguments], np.ndarray]

    def error(self, law: EvaluatedLaw, arguments: LawArguments) -> float:
        """Return the largest relative difference between the two changed values."""
        plain = np.asarray(law(arguments))
        changed = np.asarray(law({**arguments, **self.before(arguments)}))
        size = max(float(np.abs(plain).max()), 1e-300)
        return float(np.abs(changed - self.after(plain, arguments)).max()) / size


@dataclass(frozen=True)
class Dissipative(Invariant):
    """A law that dissipates energy: the product of value and rates has one sign.

    Parameters
    ----------
    law : str
        As in `Invariant`.
    rates : tuple of str
        Names of the arguments that are rates.
    sign : int
        1 for inner forces, which resist deformation; -1 for loads, which resist motion.
    """

    law: str
    rates: tuple[str, ...]
    sign: int
    sentence: str = "dissipates energy"

    def error(self, law: EvaluatedLaw, arguments: LawArguments) -> float:
        """Return the largest power supplied, relative to the largest dissipated."""
        value = np.asarray(law(arguments)).reshape(len(self.rates), -1)
        power = np.zeros(value.shape[1])
        for i, rate in enumerate(self.rates):
            power = power + self.sign * value[i] * arguments[rate]
        return float(max(-power.min(), 0.0) / max(np.abs(power).max(), 1e-300))


def is_odd(law: str, *names: str) -> Invariant:
    """Declare that the value changes sign if all these arguments do."""
    sentence = f"{law} is odd in {', '.join(names)}"
    return _scales(law, sentence, names, -1, value_factor=-1)


def is_even(law: str, *names: str) -> Invariant:
    """Declare that the value is unchanged if all these arguments change sign."""
    sentence = f"{law} is even in {', '.join(names)}"
    return _scales(law, sentence, names, -1, value_factor=1)


def vanishes_at_zero(law: str, *names: str) -> Invariant:
    """Declare that the value is zero if these arguments are zero."""
    sentence = f"{law} is zero at zero {', '.join(names)}"
    return _scales(law, sentence, names, 0, value_factor=0)


def reduces_to(law: str, name: str, *others: str) -> Invariant:
    """Declare that the value equals one argument if the others are zero."""
    return Equivariant(
        law,
        f"{law} equals {name} if {', '.join(others)} are zero",
        lambda arguments: _scale_arguments(arguments, others, 0),
        lambda value, arguments: arguments[name],
    )


def rotates_with(law: str, *vectors: str) -> Invariant:
    """Declare that the value rotates with these vectors.

    vectors: names without their x and y.
    """

    def move_arguments(arguments: LawArguments) -> LawArguments:
        rotated = {}
        for name in vectors:
            x, y = f"{name}x", f"{name}y"
            rotated[x], rotated[y] = _rotate(arguments[x], arguments[y])
        return rotated

    return Equivariant(
        law,
        f"{law} rotates with its vectors",
        move_arguments,
        lambda value, arguments: np.stack(_rotate(*value)),
    )


def resists(law: str) -> Dissipative:
    """Declare that an inner force dissipates energy."""
    return Dissipative(law, ("rate",), 1)


def brakes(law: str, *velocity: str) -> Dissipative:
    """Declare that a load dissipates energy.

    velocity: names of its components.
    """
    return Dissipative(law, velocity, -1)


def shifts_with(law: str, name: str) -> Invariant:
    """Declare that the value shifts with this argument."""
    return Equivariant(
        law,
        f"{law} shifts with {name}",
        lambda arguments: {name: arguments[name] + TEST_SHIFT},
        lambda value, arguments: value + TEST_SHIFT,
    )


def moves_with_pose(law: str, name: str) -> Invariant:
    """Declare that the value moves with poses (..., 3)."""
    return Equivariant(
        law,
        f"{law} moves with {name}",
        lambda arguments: {name: _move_pose(arguments[name])},
        lambda value, arguments: _move_pose(value),
    )


def rotates_about_centre(law: str) -> Invariant:
    """Declare that the value rotates with its points about the image centre."""

    def rotate_about(points: np.ndarray, centre: np.ndarray) -> np.ndarray:
        x, y = np.moveaxis(points - centre, -1, 0)
        return centre + np.stack(_rotate(x, y), axis=-1)

    def move_arguments(arguments: LawArguments) -> LawArguments:
        centre = arguments["camera"].centre
        return {
            "points": rotate_about(arguments["points"], centre),
            "velocity": rotate_about(arguments["velocity"], 0 * centre),
        }

    return Equivariant(
        law,
        f"{law} rotates about the image centre",
        move_arguments,
        lambda value, arguments: rotate_about(value, arguments["camera"].centre),
    )


def _scales(
    law: str,
    sentence: str,
    names: tuple[str, ...],
    factor: float,
    value_factor: float,
) -> Invariant:
    """Declare the factor of the value when these arguments change by a factor."""
    return Equivariant(
        law,
        sentence,
        lambda arguments: _scale_arguments(arguments, names, factor),
        lambda value, arguments: value_factor * value,
    )


def _scale_arguments(
    arguments: LawArguments, names: tuple[str, ...], factor: float
) -> LawArguments:
    return {name: factor * arguments[name] for name in names}


def _rotate(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    c, s = np.cos(TEST_ROTATION_RAD), np.sin(TEST_ROTATION_RAD)
    return c * x - s * y, s * x + c * y


def _move_pose(pose: np.ndarray) -> np.ndarray:
    x, y = _rotate(pose[..., 0], pose[..., 1])
    return np.stack([x + 0.2, y - 0.3, pose[..., 2] + TEST_ROTATION_RAD], axis=-1)
