"""Candidates in several trials as one batch: what a simulation costs before its first
step is paid once, and few candidates fill the vector units and the cores.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import get_num_threads

from stringcast.stages.inference.prepared_trial import (
    MAX_BATCH_CANDIDATES,
    PreparedTrial,
)
from stringcast.stages.model.engine import kernel_codegen
from stringcast.stages.model.engine.simulate import simulate
from stringcast.stages.model.hand import HandMotion, append_rest_ticks
from stringcast.stages.model.model import Model
from stringcast.stages.model.state import StringState

# [s] of simulated time that a batch costs before its first step
BATCH_OVERHEAD_S = 0.05
# times what steps cost where each candidate has a hand of its own
SEPARATE_HANDS_COST = 1.15


def normalised_residuals(
    model: Model, cases: Sequence[PreparedTrial], values: np.ndarray
) -> list[np.ndarray]:
    """How far candidates (C, P) are from what was measured in each trial, over sigma:
    both coordinates of each point, (C, 2 n); NaN where a run was rejected.
    """
    parts = []
    for first in range(0, len(values), MAX_BATCH_CANDIDATES):
        seen = simulate_trials(
            model, cases, values[first : first + MAX_BATCH_CANDIDATES]
        )
        pairs = zip(cases, seen, strict=True)
        parts.append(
            [
                ((c.sample_at_points(p) - c.points) / c.sigma[:, None]).reshape(
                    len(p), -1
                )
                for c, p in pairs
            ]
        )
    return [np.concatenate(own) for own in zip(*parts, strict=True)]


def simulate_trials(
    model: Model, cases: Sequence[PreparedTrial], values: np.ndarray
) -> list[np.ndarray]:
    """What the camera reports of candidates (C, P) in each trial, (C, F, n, 2) [m]; NaN
    where a run was rejected.
    """
    # side by side go those at rest, and those moving at the same time of a clock
    alike: dict[object, list[int]] = {}
    begins = [
        case.motion.start if case.initial_state is None else case.initial_state.t
        for case in cases
    ]
    for i, (case, begin) in enumerate(zip(cases, begins, strict=True)):
        alike.setdefault(
            (case.initial_state is None, begin, case.motion.tick), []
        ).append(i)
    result: dict[int, np.ndarray] = {}
    for numbers in alike.values():
        seconds = [float(cases[i].times[-1] - begins[i]) for i in numbers]
        for chosen in _plan_batches(
            seconds, len(values) / kernel_codegen.LANES / get_num_threads()
        ):
            some = [numbers[place] for place in chosen]
            result |= zip(
                some,
                _simulate_batch(model, [cases[i] for i in some], values),
                strict=True,
            )
    return [result[i] for i in range(len(cases))]


def _plan_batches(seconds: Sequence[float], rounds: float) -> list[list[int]]:
    """Places of trials that go together, for the least time in all: a batch lasts as
    long as its longest trial.

    seconds: how long each is. rounds: how often the candidates of one would fill the
    vector units of all cores.
    """
    order = [int(i) for i in np.argsort(seconds, kind="stable")]
    best: list[tuple[float, list[list[int]]]] = [(0.0, [])]
    for last in range(1, len(order) + 1):
        tried = []
        for first in range(last):
            batch = order[first:last]
            dearer = SEPARATE_HANDS_COST if len(batch) > 1 else 1.0
            price = (
                BATCH_OVERHEAD_S
                + dearer * np.ceil(len(batch) * rounds) * seconds[batch[-1]]
            )
            tried.append((best[first][0] + price, [*best[first][1], batch]))
        best.append(min(tried, key=lambda one: one[0]))
    return best[-1][1]


def _simulate_batch(
    model: Model, cases: Sequence[PreparedTrial], values: np.ndarray
) -> list[np.ndarray]:
    """Of trials that are simulated side by side. Clocks of strings that move count from
    there, shorter trials stay at their last moment, and hands that end earlier rest.
    """
    if len(cases) == 1:
        return [
            model.simulate_observation(
                case.motion, values, case.times, case.initial_state, case.turn
            ).points
            for case in cases
        ]
    count = len(values)
    begun = [
        model.initial_state_on_arm_clock(case.initial_state, values) for case in cases
    ]
    moments = [
        np.atleast_2d(model.required_times(values, case.times)) for case in cases
    ]
    counted = [
        m if begin is None else begin.times_since_start(m)
        for m, begin in zip(moments, begun, strict=True)
    ]
    frames = max(own.shape[1] for own in counted)
    lasting = [
        np.pad(own, ((0, 0), (0, frames - own.shape[1])), mode="edge")
        for own in counted
    ]

    pairs = zip(
        (model.hand_motion(case.motion, values) for case in cases), begun, strict=True
    )
    hands = [
        hand if begin is None else hand.starting_at(begin.t) for hand, begin in pairs
    ]
    longest = max(hand.pose.shape[1] for hand in hands)
    moved = [
        append_rest_ticks(hand.pose, hand.rate, longest - hand.pose.shape[1])
        for hand in hands
    ]
    pose, rate = (_stack_rows(rows, count) for rows in zip(*moved, strict=True))
    hand = HandMotion(hands[0].start, hands[0].tick, pose, rate)

    string = np.tile(values[:, : len(model.string.parameters)], (len(cases), 1))
    states = _stack_states([begin for begin in begun if begin is not None], count)
    turn = np.repeat([case.turn for case in cases], count)
    points = simulate(
        model.string, hand, string, _stack_rows(lasting, count), states, turn
    ).points
    told = zip(np.split(points, len(cases)), moments, cases, strict=True)
    return [
        model.observed_points(own[:, : m.shape[-1]], values, case.times)
        for own, m, case in told
    ]


def _stack_states(states: Sequence[StringState], count: int) -> StringState | None:
    """The states of several trials, for so many candidates of each, whose time counts
    from there; None of those at rest.
    """
    if not states:
        return None
    rows = zip(*((state.s, state.angle, state.rate) for state in states), strict=True)
    s, angle, rate = (
        _stack_rows([np.atleast_2d(part) for part in parts], count) for parts in rows
    )
    return StringState(
        0.0,
        s,
        angle,
        rate,
        _stack_rows([np.atleast_1d(state.memory_reversal) for state in states], count),
    )


def _stack_rows(parts: Sequence[np.ndarray], count: int) -> np.ndarray:
    """Rows (1 or C, ...) of several trials for `count` candidates of each, below one
    another, (C', ...).
    """
    return np.concatenate(
        [np.broadcast_to(part, (count, *part.shape[1:])) for part in parts]
    )
