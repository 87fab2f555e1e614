"""Simulate candidates in several trials as one batch.

A batch has the fixed cost of one simulation, and uses all vector units and cores even
with few candidates.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numba import get_num_threads

from stringcast.stages.inference.kept_points import KeptPoints
from stringcast.stages.inference.prepared_trial import (
    MAX_BATCH_CANDIDATES,
    PreparedTrial,
)
from stringcast.stages.model.engine import kernel_codegen
from stringcast.stages.model.engine.simulate import simulate
from stringcast.stages.model.hand import HandMotion, append_rest_ticks
from stringcast.stages.model.model import Model
from stringcast.stages.model.state import StringState

# Fixed cost of a batch in simulated time: 4 ms, while one simulated second of 16
# strings with 21 points takes 4 to 5 ms
BATCH_OVERHEAD_S = 0.8
# Largest simulated time of a batch, summed over candidates: limits the memory to some
# 200 MB at 21 points and steps of 5 ms
MAX_BATCH_S = 1000.0
# relative cost of a step if each candidate has its own hand motion
SEPARATE_HANDS_COST = 1.15
_KEPT_POINTS = KeptPoints()


def normalised_residuals(
    model: Model,
    trials: Sequence[PreparedTrial],
    values: np.ndarray,
) -> list[np.ndarray]:
    """Compute simulated minus measured points over sigma for candidates (C, P).

    Returns both coordinates of each point of each trial, (C, 2 n); NaN where a
    simulation was rejected.
    """
    points = measured_points(model, trials, values)
    residuals = []
    for trial, simulated in zip(trials, points, strict=True):
        residuals.append(trial.normalised_residuals(simulated))
    return residuals


def measured_points(
    model: Model,
    trials: Sequence[PreparedTrial],
    values: np.ndarray,
) -> list[np.ndarray]:
    """Simulate the measured points of candidates (C, P) in each trial, (C, n, 2) [m].

    Recent simulations are looked up (`kept_points`).
    """
    points_by_trial = [_KEPT_POINTS.find(model, trial, values) for trial in trials]

    # Trials that need the same candidates are simulated together
    trials_by_missing = defaultdict[tuple[int, ...], list[int]](list)
    for k, points in enumerate(points_by_trial):
        missing = tuple(c for c in range(len(values)) if c not in points)
        trials_by_missing[missing].append(k)
    trials_by_missing.pop((), None)
    for missing, numbers in trials_by_missing.items():
        new_values = values[list(missing)]
        simulated = _simulate_points(model, [trials[k] for k in numbers], new_values)
        for k, rows in zip(numbers, simulated, strict=True):
            new = [row.copy() for row in rows]
            _KEPT_POINTS.store(model, trials[k], new_values, new)
            points_by_trial[k] |= zip(missing, new, strict=True)

    candidates = range(len(values))
    return [np.stack([points[c] for c in candidates]) for points in points_by_trial]


def _simulate_points(
    model: Model,
    trials: Sequence[PreparedTrial],
    values: np.ndarray,
) -> list[np.ndarray]:
    """Simulate the measured points in chunks of candidates that fit into memory."""
    chunks: list[list[np.ndarray]] = [[] for _ in trials]
    longest_s = max(float(np.ptp(trial.times)) for trial in trials)
    longest_s = max(longest_s, MAX_BATCH_S / MAX_BATCH_CANDIDATES)
    size = max(int(MAX_BATCH_S / longest_s), kernel_codegen.LANES)
    for first in range(0, len(values), size):
        chunk = values[first : first + size]
        simulated = simulate_trials(model, trials, chunk)
        for k, trial in enumerate(trials):
            chunks[k].append(trial.sample_at_points(simulated[k]))
    return [_join_rows(points) for points in chunks]


def _join_rows(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Concatenate rows, without a copy of a single part."""
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def candidates_at_once(trials: Sequence[PreparedTrial]) -> int:
    """Count the candidates that take as long in these trials as one.

    Trials that can share a batch share its lanes.
    """
    groups = _groups_that_share_batches(trials).values()
    largest = max(len(group) for group in groups)
    return max(kernel_codegen.LANES // largest, 1)


def _groups_that_share_batches(
    trials: Sequence[PreparedTrial],
) -> Mapping[object, list[int]]:
    """Group the indices of trials that start at rest, or moving at the same time."""
    groups: defaultdict[object, list[int]] = defaultdict(list)
    for k, trial in enumerate(trials):
        is_at_rest = trial.initial_state is None
        groups[is_at_rest, trial.start, trial.motion.tick].append(k)
    return groups


def simulate_trials(
    model: Model,
    trials: Sequence[PreparedTrial],
    values: np.ndarray,
) -> list[np.ndarray]:
    """Simulate candidates (C, P) in each trial, in shared batches where that is faster.

    Returns what the camera reports, (C, F, n, 2) [m] of each trial; NaN where a
    simulation was rejected.
    """
    simulated: dict[int, np.ndarray] = {}
    for group in _groups_that_share_batches(trials).values():
        seconds = [float(trials[k].times[-1] - trials[k].start) for k in group]
        for batch in _plan_batches(seconds, len(values)):
            members = [group[i] for i in batch]
            points = _simulate_batch(model, [trials[k] for k in members], values)
            simulated |= zip(members, points, strict=True)
    return [simulated[k] for k in range(len(trials))]


def _plan_batches(seconds: Sequence[float], candidates: int) -> list[list[int]]:
    """Split trials into batches of the least total time (dynamic programming).

    The time of a batch is that of its longest trial, times the number of passes that
    its candidates need on the vector units of all cores.

    seconds: duration of each trial. candidates: number per trial.
    """
    loads = candidates / kernel_codegen.LANES / get_num_threads()
    order = np.argsort(seconds, kind="stable")
    total_s = np.zeros(len(order) + 1)  # least time of the i shortest trials
    best_first = []  # first trial of their last batch
    for last in range(1, len(order) + 1):
        longest_s = seconds[order[last - 1]]
        sizes = np.arange(last, 0, -1)
        cost = np.where(sizes > 1, SEPARATE_HANDS_COST, 1.0)
        batch_s = BATCH_OVERHEAD_S + cost * np.ceil(sizes * loads) * longest_s
        is_too_large = (sizes > 1) & (sizes * candidates * longest_s > MAX_BATCH_S)
        option_s = total_s[:last] + np.where(is_too_large, np.inf, batch_s)
        first = int(np.argmin(option_s))
        best_first.append(first)
        total_s[last] = option_s[first]

    batches: list[list[int]] = []
    last = len(order)
    while last > 0:
        first = best_first[last - 1]
        batches.insert(0, order[first:last].tolist())
        last = first
    return batches


def _simulate_batch(
    model: Model,
    trials: Sequence[PreparedTrial],
    values: np.ndarray,
) -> list[np.ndarray]:
    """Simulate candidates in trials that share a batch.

    Times of strings that start moving count from their start. Shorter trials repeat
    their last time, and hands whose motion ends earlier rest.
    """
    if len(trials) == 1:
        (trial,) = trials
        motion = model.simulate_observation(
            trial.motion,
            values,
            trial.times,
            trial.initial_state,
            trial.turn,
        )
        return [motion.points]

    lanes = [_lane(model, trial, values) for trial in trials]
    frames = max(lane.times.shape[1] for lane in lanes)
    ticks = max(lane.hand.pose.shape[1] for lane in lanes)
    count = len(values)

    times = []
    poses = []
    rates = []
    for lane in lanes:
        missing = frames - lane.times.shape[1]
        times.append(np.pad(lane.times, ((0, 0), (0, missing)), mode="edge"))
        hand = lane.hand
        pose, rate = append_rest_ticks(hand.pose, hand.rate, ticks - hand.pose.shape[1])
        poses.append(pose)
        rates.append(rate)

    first = lanes[0].hand
    motion = simulate(
        model.string,
        HandMotion(
            first.start,
            first.tick,
            _stack_rows(poses, count),
            _stack_rows(rates, count),
        ),
        np.tile(values[:, : len(model.string.parameters)], (len(trials), 1)),
        _stack_rows(times, count),
        _stack_states([lane.start for lane in lanes], count),
        np.repeat([trial.turn for trial in trials], count),
    )

    reported = []
    strings = np.split(motion.points, len(trials))
    for trial, lane, points in zip(trials, lanes, strings, strict=True):
        own_frames = points[:, : lane.times.shape[1]]
        reported.append(model.observed_points(own_frames, values, trial.times))
    return reported


@dataclass(frozen=True)
class _Lane:
    """The simulation of one trial: hand, times (1 or C, M) [s], initial state."""

    hand: HandMotion
    times: np.ndarray
    start: StringState | None


def _lane(model: Model, trial: PreparedTrial, values: np.ndarray) -> _Lane:
    start = model.initial_state_on_arm_clock(trial.initial_state, values)
    hand = model.hand_motion(trial.motion, values)
    moments = np.atleast_2d(model.required_times(values, trial.times))
    if start is None:
        return _Lane(hand, moments, None)
    return _Lane(hand.starting_at(start.t), start.times_since_start(moments), start)


def _stack_states(
    starts: Sequence[StringState | None],
    count: int,
) -> StringState | None:
    """Stack the states of several trials for `count` candidates of each.

    Their time starts at 0. Returns None for trials at rest.
    """
    states = [state for state in starts if state is not None]
    if not states:
        return None
    s = [np.atleast_2d(state.s) for state in states]
    angle = [np.atleast_2d(state.angle) for state in states]
    rate = [np.atleast_2d(state.rate) for state in states]
    reversal = [np.atleast_1d(state.memory_reversal) for state in states]
    stacked = [_stack_rows(rows, count) for rows in (s, angle, rate, reversal)]
    return StringState(0.0, *stacked)


def _stack_rows(parts: Sequence[np.ndarray], count: int) -> np.ndarray:
    """Stack rows (1 or C, ...) of several trials for `count` candidates of each."""
    rows = [np.broadcast_to(part, (count, *part.shape[1:])) for part in parts]
    return np.concatenate(rows)
