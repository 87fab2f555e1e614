"""Candidates in several trials as one batch: what a simulation costs before its first step is paid once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stages.estimate.forward import Case
from stages.model.hand import HandMotion
from stages.model.model import Model
from stages.model.string import simulate


def seen_together(model: Model, cases: Sequence[Case], values: np.ndarray) -> list[np.ndarray]:
    """What the camera reports of candidates (C, P) in each trial, (C, F, n, 2) [m]; NaN where a run was rejected."""
    result: list[np.ndarray | None] = [None] * len(cases)
    for chosen in _batches(cases):
        some = [cases[i] for i in chosen]
        alone = len(some) == 1
        seen = [model.seen(c.motion, values, c.times, c.initial).points for c in some] if alone else None
        for i, points in zip(chosen, seen or _seen(model, some, values), strict=True):
            result[i] = points
    return [points for points in result if points is not None]


def _batches(cases: Sequence[Case]) -> list[list[int]]:
    """Trials that begin at rest at the same time of their clock go together; each of the others alone."""
    batches: dict[object, list[int]] = {}
    for i, case in enumerate(cases):
        key = ("moving", i) if case.initial is not None else (case.motion.start, case.motion.tick)
        batches.setdefault(key, []).append(i)
    return list(batches.values())


def _seen(model: Model, cases: Sequence[Case], values: np.ndarray) -> list[np.ndarray]:
    hands = [model.hand(case.motion, values) for case in cases]
    moments = [np.atleast_2d(model.moments(values, case.times)) for case in cases]
    ticks, wanted = max(hand.pose.shape[1] for hand in hands), max(m.shape[-1] for m in moments)
    pose = np.concatenate([_rested(hand.pose, len(values), ticks) for hand in hands])
    rate = np.concatenate([_rested(hand.rate, len(values), ticks, still=True) for hand in hands])
    times = np.concatenate([_rested(m, len(values), wanted) for m in moments])
    string = np.tile(values[:, : len(model.string.parameters)], (len(cases), 1))
    points = simulate(model.string, HandMotion(hands[0].start, hands[0].tick, pose, rate), string, times).points
    return [
        model.reported(own[:, : m.shape[-1]], values, case.times)
        for own, m, case in zip(np.split(points, len(cases)), moments, cases, strict=True)
    ]


def _rested(rows: np.ndarray, count: int, length: int, still: bool = False) -> np.ndarray:
    """Rows (1 or C, K, ...) for `count` candidates, at their last value (or zero) until they are `length` long."""
    every = np.broadcast_to(rows, (count, *rows.shape[1:]))
    last = np.repeat(every[:, -1:] * (0.0 if still else 1.0), length - rows.shape[1], axis=1)
    return np.concatenate([every, last], axis=1)
