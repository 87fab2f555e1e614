"""Where an effect that depends on place could act: on the string's way, not on all of it, and not on the hand's.

Asked of the effect's own law, without any simulation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import cast

import numpy as np
from scipy.stats import qmc

from stringcast.stages.inference.evidence import Data, Fit, Hypothesis
from stringcast.stages.inference.forward import Case
from stringcast.stages.model.effect import Effect, StringEffect, components
from stringcast.stages.model.parameter import Parameter, values_of
from stringcast.stages.model.stability import load

DRAWS = 10  # places of which it is asked, as a power of two
TRIED = 48  # of these that are simulated
FIRM = 0.1  # of the range of its size: a cushion's stiffness of a plane's
TOUCHED = 0.1  # of the string's places on its way, at most: what acts on more is no touch
STRING, HAND = 20_000, 300  # places on the ways of the string and of the hand
AT_ONCE = 256  # candidates of which it is asked


@dataclass(frozen=True)
class Places:
    """start: exponents (P,) with the effect absent. own: places of its size and of what says where. string, hand: ways
    through all trials, arguments of laws (M,) each."""

    hypothesis: Hypothesis
    start: np.ndarray
    own: list[int]
    string: Mapping[str, np.ndarray]
    hand: Mapping[str, np.ndarray]
    seed: int

    @property
    def effect(self) -> type[Effect]:
        """Whose places they are."""
        return self.hypothesis.causes[-1]

    def drawn(self) -> np.ndarray:
        """Exponents (C, P) at which it acts, anywhere."""
        chi = np.repeat(self.start[None], 2**DRAWS, axis=0)
        chi[:, self.own] = qmc.Sobol(len(self.own), seed=self.seed).random_base2(DRAWS)
        chi[:, self.own[0]] = self.start[self.own[0]] + FIRM * (1 - self.start[self.own[0]])
        return self._possible(chi)[:TRIED]

    def about(self, chi: np.ndarray, reach: float, rng: np.random.Generator) -> np.ndarray:
        """Exponents (C', P) at which it acts, within reach of those given."""
        near, where = chi.copy(), self.own[1:]
        near[:, where] = np.clip(near[:, where] + rng.uniform(-reach, reach, (len(near), len(where))), 0, 1)
        return self._possible(near)

    def _possible(self, chi: np.ndarray) -> np.ndarray:
        chi = chi[~self._pushed(chi, self.hand).any(axis=1)]  # first: the hand's way is short
        share = self._pushed(chi, self.string).mean(axis=1)
        return chi[(share > 0) & (share < TOUCHED)]

    def _pushed(self, chi: np.ndarray, way: Mapping[str, np.ndarray]) -> np.ndarray:
        """Whether it acts there, (C, M)."""
        string, parts = self.hypothesis.model.string, [np.zeros((0, len(way["x"])), dtype=bool)]
        for some in np.array_split(chi, -(-len(chi) // AT_ONCE)) if len(chi) else []:
            material = string.material(values_of(self.hypothesis.parameters, some)[:, : len(string.parameters)])
            alone = string.only((cast("type[StringEffect]", self.effect),), material)
            parts.append(np.any(load(*alone, {name: each[None] for name, each in way.items()}) != 0, axis=-1))
        return np.concatenate(parts)


def varied_parameters(effect: type[Effect]) -> list[Parameter]:
    """An effect's size, other components of that, and what says where or when: those with which it is tried.

    Others that start at an end of their range are sizes too (of friction, say), and stay absent.
    """
    return [p for p in effect.parameters if p in components(effect) or p.low < p.start < p.high]


def touching(data: Data, parent: Fit, hypothesis: Hypothesis, seed: int) -> Places:
    """Of the last cause of a hypothesis, on the way of its parent's string."""
    effect = hypothesis.causes[-1]
    own = hypothesis.places(effect, varied_parameters(effect))
    values = values_of(parent.hypothesis.parameters, parent.chi[None])
    string = _thinned([_way(trial, parent, values) for trial in data.trials], STRING)
    poses = [parent.hypothesis.model.hand(trial.motion, values).pose[0] for trial in data.trials]
    hand = _thinned([{"x": pose[:, 0], "y": pose[:, 1]} for pose in poses], HAND)
    return Places(hypothesis, hypothesis.carried(parent.named), own, string, hand, seed)


def _way(trial: Case, parent: Fit, values: np.ndarray) -> dict[str, np.ndarray]:
    """Of the fitted string through a trial: arguments of laws, (M,) each."""
    model = parent.hypothesis.model
    points = model.true(trial.motion, values, trial.times, trial.initial).points[0]
    return way_of(points, model.string.arc_lengths(), trial.times)


def way_of(points: np.ndarray, s: np.ndarray, times: np.ndarray) -> dict[str, np.ndarray]:
    """Arguments of laws, (M,) each, where a string's points (F, n, 2) [m] are but that in the hand. s: (n,) arc lengths
    [m]; times: (F,) [s]."""
    velocity = np.gradient(points, times, axis=0) if len(times) > 1 else np.zeros_like(points)
    tangent = np.gradient(points, axis=1)
    tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
    along, moment = np.meshgrid(s, times)
    axes = {"x": points, "vx": velocity, "ux": velocity, "tx": tangent}
    known = {name: array[..., 0] for name, array in axes.items()}
    known |= {name.replace("x", "y"): array[..., 1] for name, array in axes.items()} | {"s": along, "t": moment}
    return {name: array[:, 1:].ravel() for name, array in known.items()}


def _thinned(ways: list[dict[str, np.ndarray]], count: int) -> dict[str, np.ndarray]:
    """Some places of several ways, evenly, about `count`."""
    joined = {name: np.concatenate([way[name] for way in ways]) for name in ways[0]}
    return {name: each[:: max(len(each) // count, 1)] for name, each in joined.items()}
