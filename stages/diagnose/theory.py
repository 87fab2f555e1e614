"""A theory: the base model with some of the library's effects at work, and the trials it must explain.

All effects on the string share one model in which those that are not at work are absent (at
their start): one compiled loop serves every theory.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import cast

import numpy as np

from stringcast.stages.diagnose.evidence import Evidence
from stringcast.stages.model.effect import CameraEffect, Effect, StringEffect, placed
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import Parameter, values_of
from stringcast.stages.model.stability import load

HAND = 300  # places on the hand's way at which it is asked whether something stands there
AT_ONCE = 256  # effects of which a place is asked


@dataclass(frozen=True)
class Theory:
    """model: with more effects than are at work, perhaps. causes: those that are, beyond the base model's own. hand:
    places where the hand was, (M, 2) [m]. held: names of the causes' parameters that stay where they are."""

    model: Model
    causes: tuple[type[Effect], ...]
    base: tuple[str, ...]
    hand: np.ndarray = field(default_factory=lambda: np.empty((0, 2)), compare=False)
    held: frozenset[str] = frozenset()

    @cached_property
    def free(self) -> np.ndarray:
        """Places of the parameters that are fitted: the base model's and the causes'."""
        own = {e.qualified(p) for e in self.causes for p in e.parameters} - self.held
        return np.array([i for i, name in enumerate(self.model.names) if name in self.base or name in own])

    @property
    def parameters(self) -> int:
        """How many are its own: those that are fitted, and those that are held."""
        return len(self.free) + len(self.held)

    @cached_property
    def own(self) -> frozenset[str]:
        """Names of the parameters that are fitted."""
        return frozenset(self.model.names[i] for i in self.free)

    @cached_property
    def start(self) -> np.ndarray:
        """(P,) exponents at which all effects are absent and the base model is at its start."""
        return np.array([float(p.chi(np.asarray(p.start))) for p in self.model.parameters])

    @cached_property
    def decades(self) -> np.ndarray:
        """(free,) logarithm of high over low of what is sought in exponential form, else 0."""
        ranges = [self.model.parameters[i] for i in self.free]
        return np.array([np.log(p.high / p.low) if p.low > 0 else 0.0 for p in ranges])

    @cached_property
    def centre(self) -> np.ndarray:
        """(free,) what is expected before the data speak: the middle of a range, and no cause."""
        base = np.array([self.model.names[i] in self.base for i in self.free])
        return np.where(base, 0.5, self.start[self.free])

    def carried(self, known: Mapping[str, float]) -> np.ndarray:
        """(P,) exponents known by name; those of others at their start."""
        return np.array([known.get(name, chi) for name, chi in zip(self.model.names, self.start, strict=True)])

    def at(self, values: Mapping[str, float]) -> np.ndarray:
        """(P,) exponents of values known by name; those of others at their start."""
        known = {p.name: float(p.chi(np.asarray(values[p.name]))) for p in self.model.parameters if p.name in values}
        return self.carried(known)

    def named(self, chi: np.ndarray) -> dict[str, float]:
        """Exponents (P,) of the free parameters, by name."""
        return {self.model.names[i]: float(chi[i]) for i in self.free}

    def of(self, cause: type[Effect], chi: np.ndarray) -> dict[str, float]:
        """A cause's parameters by their own names, at exponents (P,)."""
        places = zip(cause.parameters, self.places(cause, cause.parameters), strict=True)
        return {p.name: float(self.model.parameters[i].value(chi[i])) for p, i in places}

    def places(self, cause: type[Effect], parameters: Sequence[Parameter]) -> list[int]:
        """Of some parameters of a cause, among all."""
        return [self.model.names.index(cause.qualified(p)) for p in parameters]

    def plausible(self, chi: np.ndarray) -> bool:
        """Whether each cause has values that can be what it says, at exponents (P,), and nothing stands where the
        hand was."""
        if not all(cause.plausible(self.of(cause, chi)) for cause in self.causes):
            return False
        return not any(self.on_hand(cause, chi[None])[0] for cause in self.causes if placed(cause))

    def on_hand(self, cause: type[Effect], chi: np.ndarray) -> np.ndarray:
        """Whether a cause that depends on place would push where the hand was, (C,), at exponents (C, P)."""
        there = self.pushed(cause, chi, {"x": self.hand[:, 0], "y": self.hand[:, 1]})
        return np.asarray(there.any(axis=1))

    def pushed(self, cause: type[Effect], chi: np.ndarray, place: Mapping[str, np.ndarray]) -> np.ndarray:
        """Whether a cause that depends on place pushes there, (C, M), at exponents (C, P).

        place: arguments of its law, (M,) each; those not given are 0. Asked of the law itself, without any simulation.
        """
        many = np.array_split(chi, -(-len(chi) // AT_ONCE)) if len(chi) else []
        parts = [self._pushed(cause, some, place) for some in many]
        return np.concatenate(parts) if parts else np.zeros((0, len(place["x"])), dtype=bool)

    def _pushed(self, cause: type[Effect], chi: np.ndarray, place: Mapping[str, np.ndarray]) -> np.ndarray:
        string = self.model.string
        material = string.material(values_of(self.model.parameters, chi)[:, : len(string.parameters)])
        alone = string.only((cast("type[StringEffect]", cause),), material)
        return np.asarray(np.any(load(*alone, {name: each[None] for name, each in place.items()}) != 0, axis=-1))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the causes."""
        return tuple(cause.name for cause in self.causes)


def whole(base: Model, effects: Sequence[type[Effect]], evidence: Evidence) -> Theory:
    """The base model as a theory, with effects at hand that are absent: candidates of which then share a batch.

    Not those that depend on place, since what they push must be found anew for each place of the string at rest,
    nor those of the camera, which ask for velocities: these cost more than all the others.
    """
    cheap = [e for e in effects if not issubclass(e, CameraEffect) and not placed(e)]
    return Theory(base.with_effects(*cheap), (), base.names, hand_way(base, evidence))


def hand_way(model: Model, evidence: Evidence) -> np.ndarray:
    """Some places on the hand's way through all trials, (M, 2) [m]."""
    start = np.array([[p.start for p in model.parameters]])
    way = np.concatenate([model.hand(case.motion, start).pose[0, :, :2] for case in evidence.cases])
    return way[:: max(len(way) // HAND, 1)]


def joined(theory: Theory, *effects: type[Effect]) -> Theory:
    """The theory with more causes."""
    new = tuple(e for e in effects if e not in theory.model.effects)
    return replace(theory, model=theory.model.with_effects(*new), causes=(*theory.causes, *effects))
