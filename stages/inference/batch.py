"""Candidates in several trials as one batch: what a simulation costs before its first step is paid once, and few
candidates fill the vector units and the cores."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import get_num_threads

from stringcast.stages.inference.forward import Case
from stringcast.stages.model import kernel
from stringcast.stages.model.hand import HandMotion, rested
from stringcast.stages.model.model import Model
from stringcast.stages.model.simulate import simulate
from stringcast.stages.model.state import State

BEGINNING = 0.05  # [s] of simulated time that a batch costs before its first step
APART = 1.15  # times what steps cost where each candidate has a hand of its own


def seen_together(model: Model, cases: Sequence[Case], values: np.ndarray) -> list[np.ndarray]:
    """What the camera reports of candidates (C, P) in each trial, (C, F, n, 2) [m]; NaN where a run was rejected."""
    result: dict[int, np.ndarray] = {}
    for alike in _alike(cases):
        lanes = len(values) / kernel.WIDTH
        for chosen in _batches([_seconds(cases[i]) for i in alike], lanes / get_num_threads()):
            numbers = [alike[place] for place in chosen]
            result |= zip(numbers, _seen(model, [cases[i] for i in numbers], values), strict=True)
    return [result[i] for i in range(len(cases))]


def _alike(cases: Sequence[Case]) -> list[list[int]]:
    """Trials that can be simulated side by side: all at rest or all moving at the same time of their clock."""
    alike: dict[object, list[int]] = {}
    for i, case in enumerate(cases):
        begin = ("rest", case.motion.start) if case.initial is None else ("moving", case.initial.t)
        alike.setdefault((*begin, case.motion.tick), []).append(i)
    return list(alike.values())


def _seconds(case: Case) -> float:
    """How long the trial is simulated [s]."""
    begin = case.motion.start if case.initial is None else case.initial.t
    return float(case.times[-1] - begin)


def _batches(seconds: Sequence[float], rounds: float) -> list[list[int]]:
    """Places of trials that go together, for the least time in all: a batch lasts as long as its longest trial.

    seconds: how long each is. rounds: how often the candidates of one would fill the vector units of all cores.
    """
    order = [int(i) for i in np.argsort(seconds, kind="stable")]
    best: list[tuple[float, list[list[int]]]] = [(0.0, [])]
    for last in range(1, len(order) + 1):
        tried = []
        for first in range(last):
            batch = order[first:last]
            dearer = APART if len(batch) > 1 else 1.0
            price = BEGINNING + dearer * np.ceil(len(batch) * rounds) * seconds[batch[-1]]
            tried.append((best[first][0] + price, [*best[first][1], batch]))
        best.append(min(tried, key=lambda one: one[0]))
    return best[-1][1]


def _seen(model: Model, cases: Sequence[Case], values: np.ndarray) -> list[np.ndarray]:
    """Of trials that are simulated side by side."""
    if len(cases) == 1:
        return [model.seen(case.motion, values, case.times, case.initial).points for case in cases]
    begun = [model.begun(case.initial, values) for case in cases]
    hands = [_since(model.hand(case.motion, values), begin) for case, begin in zip(cases, begun, strict=True)]
    moments = [np.atleast_2d(model.moments(values, case.times)) for case in cases]
    counted = [m if begin is None else begin.counted(m) for m, begin in zip(moments, begun, strict=True)]
    string = np.tile(values[:, : len(model.string.parameters)], (len(cases), 1))
    states = _of_each([begin for begin in begun if begin is not None], len(values))
    times = _below(_lasting(counted), len(values))
    points = simulate(model.string, _side_by_side(hands, len(values)), string, times, states)
    pairs = zip(np.split(points.points, len(cases)), moments, cases, strict=True)
    return [model.reported(own[:, : m.shape[-1]], values, case.times) for own, m, case in pairs]


def _side_by_side(hands: Sequence[HandMotion], count: int) -> HandMotion:
    """Hands of several trials for so many candidates of each; those that end earlier rest."""
    longest = max(hand.pose.shape[1] for hand in hands)
    moved = [rested(hand.pose, hand.rate, longest - hand.pose.shape[1]) for hand in hands]
    pose, rate = (_below(rows, count) for rows in zip(*moved, strict=True))
    return HandMotion(hands[0].start, hands[0].tick, pose, rate)


def _since(hand: HandMotion, begin: State | None) -> HandMotion:
    return hand if begin is None else hand.since(begin.t)


def _of_each(states: Sequence[State], count: int) -> State | None:
    """The states of several trials, for so many candidates of each, whose time counts from there; None of those at
    rest."""
    if not states:
        return None
    rows = zip(*((state.s, state.angle, state.rate) for state in states), strict=True)
    s, angle, rate = (_below([np.atleast_2d(part) for part in parts], count) for parts in rows)
    return State(0.0, s, angle, rate, _below([np.atleast_1d(state.let_back) for state in states], count))


def _lasting(times: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Times of several trials, (1 or C, F) each, as many of each: shorter ones stay at their last."""
    most = max(own.shape[1] for own in times)
    return [np.pad(own, ((0, 0), (0, most - own.shape[1])), mode="edge") for own in times]


def _below(parts: Sequence[np.ndarray], count: int) -> np.ndarray:
    """Rows (1 or C, ...) of several trials for `count` candidates of each, below one another, (C', ...)."""
    return np.concatenate([np.broadcast_to(part, (count, *part.shape[1:])) for part in parts])
