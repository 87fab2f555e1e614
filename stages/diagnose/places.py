"""Where an effect that depends on place could act: on the string's way, not on all of it, and not on the hand's.

Asked of the effect's own law, without any simulation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from scipy.stats import qmc

from stringcast.stages.inference.evidence import Fit, lacked
from stringcast.stages.inference.forward import Case
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.trial_data import Data
from stringcast.stages.model.effect import Effect, StringEffect, components
from stringcast.stages.model.parameter import Parameter, values_of
from stringcast.stages.model.stability import load

DRAWS = 13  # places of which it is asked, as a power of two
TRIED = 48  # of these that are simulated
FIRM = 0.1  # of the range of its size: a cushion's stiffness of a plane's
TOUCHED = 0.1  # of the string's places on its way, at most: what acts on more is no touch
STRING, HAND = 1500, 300  # places on the string's way in a trial, and on the hand's in all
ABOUT = 256  # places of which it is asked about the best ones
AT_ONCE = 64  # candidates of which it is asked: what their law takes stays in the processor's cache
DEPARTED = 3.0  # noises by which a string that was touched is somewhere else
DEPARTURE = 0.3  # of the largest departure in any trial: what others lack besides is no touch
APART = 0.1  # [s] between touch and departure, from which one is not the other: what is lacking is told as smoothly


@dataclass(frozen=True)
class Places:
    """start: exponents (P,) with the effect absent. own: places of its size and of what says where. strings: the
    string's way in each trial, hand: all the hand's, arguments of laws (M,) each. departs: when what was measured
    departs from the string in each trial [s], infinite where it does not, (K,)."""

    hypothesis: Hypothesis
    start: np.ndarray
    own: list[int]
    strings: Sequence[Mapping[str, np.ndarray]]
    hand: Mapping[str, np.ndarray]
    departs: np.ndarray
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
        return self._likely(chi)

    def about(self, chi: np.ndarray, reach: float, rng: np.random.Generator) -> np.ndarray:
        """Exponents (C', P) at which it acts, within reach of those given."""
        near, where = np.repeat(chi, ABOUT // len(chi), axis=0), self.own[1:]
        near[:, where] = np.clip(near[:, where] + rng.uniform(-reach, reach, (len(near), len(where))), 0, 1)
        return self._likely(near)

    def _likely(self, chi: np.ndarray) -> np.ndarray:
        """Those by which the string is touched first when it departs, in each trial, and the hand never."""
        chi = chi[~self._pushed(chi, self.hand).any(axis=1)]  # first: the hand's way is short
        apart, shares = np.zeros(len(chi)), []
        for way, departs in zip(self.strings, self.departs, strict=True):
            pushed = self._pushed(chi, way)
            end = way["t"][-1] + APART  # stands for never
            first = np.where(pushed.any(axis=1), way["t"][pushed.argmax(axis=1)], end)
            apart += np.minimum(np.abs(first - min(departs, end)), APART) ** 2
            shares.append(pushed.mean(axis=1))
        share = np.mean(shares, axis=0)
        touches = np.flatnonzero((share > 0) & (share < TOUCHED))
        return chi[touches[np.argsort(apart[touches], kind="stable")[:TRIED]]]

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
    strings = [_thinned(_way(trial, parent, values), STRING) for trial in data.trials]
    poses = np.concatenate([parent.hypothesis.model.hand(trial.motion, values).pose[0] for trial in data.trials])
    hand = _thinned({"x": poses[:, 0], "y": poses[:, 1]}, HAND)
    departs = _departures(data.trials, lacked(data, parent))
    return Places(hypothesis, hypothesis.carried(parent.named), own, strings, hand, departs, seed)


def _departures(trials: Sequence[Case], lacking: Sequence[np.ndarray]) -> np.ndarray:
    """When what a string lacks, (2 n,) over sigma of each trial, is first more than noise, and more than a share of the
    most in any trial [s]; infinite where it never is, (K,)."""
    far = [np.linalg.norm(own.reshape(-1, 2), axis=1) * t.sigma for own, t in zip(lacking, trials, strict=True)]
    least = DEPARTURE * max(each.max() for each in far)
    moments = [
        t.times[t.frame[own > np.maximum(DEPARTED * t.sigma, least)]] for own, t in zip(far, trials, strict=True)
    ]
    return np.array([each.min() if len(each) else np.inf for each in moments])


def _way(trial: Case, parent: Fit, values: np.ndarray) -> dict[str, np.ndarray]:
    """Of the fitted string through a trial: arguments of laws, (M,) each."""
    model = parent.hypothesis.model
    points = model.true(trial.motion, values, trial.times, trial.initial, trial.turn).points[0]
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


def _thinned(way: Mapping[str, np.ndarray], count: int) -> dict[str, np.ndarray]:
    """Some places of a way, evenly, about `count`."""
    return {name: each[:: max(len(each) // count, 1)] for name, each in way.items()}
