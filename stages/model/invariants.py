"""Invariants: properties of a law that an effect declares and tests check on samples.

Each is checked on samples: `error` takes the law's arguments as arrays (a sample an
entry) and says how far the law is from keeping its word, as a share of the law's size.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

LawArguments = Mapping[str, Any]
TEST_ROTATION_RAD = 0.7  # [rad] by which directions are tried


class Invariant(ABC):
    """law: name of the law it is about. sentence: what holds."""

    law: str
    sentence: str

    @abstractmethod
    def error(
        self, law: Callable[[LawArguments], np.ndarray], given: LawArguments
    ) -> float:
        """The deviation of a law from it on these samples, as a share of the law's
        size.
        """


@dataclass(frozen=True)
class Equivariant(Invariant):
    """before: done to the arguments; after: what is then done to the value."""

    law: str
    sentence: str
    before: Callable[[LawArguments], LawArguments]
    after: Callable[[np.ndarray, LawArguments], np.ndarray]

    def error(
        self, law: Callable[[LawArguments], np.ndarray], given: LawArguments
    ) -> float:
        """Largest difference between the law of what is changed and the change of the
        law, relative.
        """
        plain, changed = (
            np.asarray(law(given)),
            np.asarray(law({**given, **self.before(given)})),
        )
        size = max(float(np.abs(plain).max()), 1e-300)
        return float(np.abs(changed - self.after(plain, given)).max()) / size


@dataclass(frozen=True)
class Dissipative(Invariant):
    """The law takes energy and never gives any: value times rates has one sign. sign: 1
    for inner forces, which resist what stretches and bends, -1 for loads, which act on
    what moves.
    """

    law: str
    rates: tuple[str, ...]
    sign: int
    sentence: str = "never gives energy"

    def error(
        self, law: Callable[[LawArguments], np.ndarray], given: LawArguments
    ) -> float:
        """Largest power given, as a share of the largest taken."""
        value = np.asarray(law(given)).reshape(len(self.rates), -1)
        power = self.sign * sum(
            value[i] * given[rate] for i, rate in enumerate(self.rates)
        )
        return _negative_share(power)


@dataclass(frozen=True)
class NeverNegative(Invariant):
    """The value has one sign."""

    law: str
    sentence: str

    def error(
        self, law: Callable[[LawArguments], np.ndarray], given: LawArguments
    ) -> float:
        """The most negative value, as a share of the largest."""
        return _negative_share(np.asarray(law(given)))


@dataclass(frozen=True)
class ReducesTo(Invariant):
    """The value is one argument where others are zero."""

    law: str
    sentence: str
    name: str
    others: tuple[str, ...]

    def error(
        self, law: Callable[[LawArguments], np.ndarray], given: LawArguments
    ) -> float:
        """Largest difference between value and argument, relative."""
        still = {**given, **{other: 0 * given[other] for other in self.others}}
        return float(
            np.abs(law(still) - given[self.name]).max() / np.abs(given[self.name]).max()
        )


def odd(law: str, *names: str) -> Invariant:
    """The value changes sign with these arguments, all together."""
    return Equivariant(
        law,
        f"{law} is odd in {', '.join(names)}",
        _negation_of(names),
        lambda value, given: -value,
    )


def even(law: str, *names: str) -> Invariant:
    """The value stays when these arguments change sign, all together."""
    return Equivariant(
        law,
        f"{law} is even in {', '.join(names)}",
        _negation_of(names),
        lambda value, given: value,
    )


def never_negative(law: str) -> Invariant:
    """The law is never negative, as a drag that takes energy and never gives any."""
    return NeverNegative(law, f"{law} is never negative")


def vanishes_at_zero(law: str, *names: str) -> Invariant:
    """The value is zero where these arguments are."""
    zero: Callable[[LawArguments], LawArguments] = lambda given: {
        name: 0 * given[name] for name in names
    }  # noqa: E731
    return Equivariant(
        law,
        f"{law} is zero at zero {', '.join(names)}",
        zero,
        lambda value, given: 0 * value,
    )


def reduces_to(law: str, name: str, *others: str) -> Invariant:
    """The invariant that the value is this argument where the others are zero."""
    return ReducesTo(
        law, f"{law} is {name} where {', '.join(others)} are zero", name, others
    )


def rotates_with(law: str, *vectors: str) -> Invariant:
    """No direction is special: turn these vectors (names less their x and y), and the
    value turns with them.
    """

    def before(given: LawArguments) -> LawArguments:
        turned = {}
        for name in vectors:
            turned[f"{name}x"], turned[f"{name}y"] = _rotate(
                given[f"{name}x"], given[f"{name}y"]
            )
        return turned

    return Equivariant(
        law,
        f"{law} knows no direction",
        before,
        lambda value, given: np.stack(_rotate(*value)),
    )


def resists(law: str, rate: str = "rate") -> Dissipative:
    """An inner force takes energy from what stretches or bends at this rate."""
    return Dissipative(law, (rate,), 1)


def brakes(law: str, *velocity: str) -> Dissipative:
    """The invariant that a load takes energy from what moves. velocity: names of its
    components.
    """
    return Dissipative(law, velocity, -1)


def shifts_with(law: str, name: str) -> Invariant:
    """No origin is special: shift this argument as a whole, and the value shifts with
    it.
    """
    shift = 0.37
    return Equivariant(
        law,
        f"{law} follows {name}",
        lambda g: {name: g[name] + shift},
        lambda value, given: value + shift,
    )


def moves_with_pose(law: str, name: str) -> Invariant:
    """No place is special: carry poses (..., 3) elsewhere, turned, and the value is
    carried along.
    """
    return Equivariant(
        law,
        f"{law} is carried with {name}",
        lambda g: {name: _move_pose(g[name])},
        lambda value, given: _move_pose(value),
    )


def rotates_about_centre(law: str) -> Invariant:
    """Turn points and velocities about the middle of the image, and what is seen turns
    with them.
    """

    def turned(points: np.ndarray, centre: np.ndarray) -> np.ndarray:
        return centre + np.stack(_rotate(*np.moveaxis(points - centre, -1, 0)), axis=-1)

    def before(given: LawArguments) -> LawArguments:
        centre = given["camera"].centre
        return {
            "points": turned(given["points"], centre),
            "velocity": turned(given["velocity"], 0 * centre),
        }

    return Equivariant(
        law,
        f"{law} knows no direction",
        before,
        lambda value, given: turned(value, given["camera"].centre),
    )


def _negative_share(values: np.ndarray) -> float:
    """The most negative value, as a share of the largest."""
    return float(max(-values.min(), 0.0) / max(np.abs(values).max(), 1e-300))


def _negation_of(names: tuple[str, ...]) -> Callable[[LawArguments], LawArguments]:
    return lambda given: {name: -given[name] for name in names}


def _rotate(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    c, s = np.cos(TEST_ROTATION_RAD), np.sin(TEST_ROTATION_RAD)
    return c * x - s * y, s * x + c * y


def _move_pose(pose: np.ndarray) -> np.ndarray:
    x, y = _rotate(pose[..., 0], pose[..., 1])
    return np.stack([x + 0.2, y - 0.3, pose[..., 2] + TEST_ROTATION_RAD], axis=-1)
