"""Interpolation between the ticks and between the mass points of a simulation."""

from __future__ import annotations

import numpy as np

from stringcast.stages.model.engine.threads import compile_kernel, parallel_for

TIME_NODES = 6  # ticks in the interpolating polynomial
PLACE_NODES = 4  # mass points in the interpolating cubic
TICK_TOLERANCE = 1e-6  # of a tick
MAX_TIP_DISTANCE_M = 1e3
# Candidates in a piece of work for a thread: each takes ten microseconds or more.
CANDIDATES_PER_PIECE = 128


def last_needed_tick(position: np.ndarray) -> np.ndarray:
    """Find the last tick that each candidate needs, (C,), or all need, (1,).

    A candidate's result must not depend on the duration of others.

    position: times, (F,) or (C, F) in ticks.
    """
    latest = np.atleast_2d(position).max(axis=1)
    return np.maximum(np.ceil(latest - 1e-9).astype(int), TIME_NODES - 1)


def is_bounded(ticks: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Return whether the tip stays within `MAX_TIP_DISTANCE_M`, (C,).

    ticks: positions, (C, K, n, 2). last: number of the last tick that counts, (C,) or
    (1,).
    """
    bounded = np.ones(len(ticks), dtype=np.bool_)
    _find_bounded(ticks, np.broadcast_to(last, len(ticks)), bounded)
    return bounded


@compile_kernel
def _find_bounded(ticks: np.ndarray, last: np.ndarray, bounded: np.ndarray) -> None:
    """Find candidates as `is_bounded`. bounded: (C,) of ones, changed in place."""
    for c in range(len(ticks)):
        for k in range(min(last[c] + 1, ticks.shape[1])):
            distance = abs(ticks[c, k, -1, 0]) + abs(ticks[c, k, -1, 1])
            if not distance < MAX_TIP_DISTANCE_M:  # true for NaN
                bounded[c] = False
                break


def interpolate_ticks(
    ticks: np.ndarray, position: np.ndarray, last: np.ndarray
) -> np.ndarray:
    """Interpolate positions between ticks by the polynomial through the nearest six.

    Parameters
    ----------
    ticks : ndarray of shape (C, K, n, 2)
        Positions at the ticks.
    position : ndarray of shape (F,) or (C, F)
        Times in ticks. Times before the first tick count as the first.
    last : ndarray of int, shape (C,) or (1,)
        As `last_needed_tick`.

    Returns
    -------
    ndarray of shape (C, F, n, 2)
    """
    position = np.maximum(position, 0)
    whole = np.round(position)
    # There the result is the tick itself.
    near_tick = np.abs(position - whole) < TICK_TOLERANCE
    position = np.where(near_tick, whole, position)
    if position.ndim == 1 and np.array_equal(position, whole):
        whole = whole.astype(int)
        if np.array_equal(whole, np.arange(ticks.shape[1])):
            return ticks
        return np.take(ticks, whole, axis=1)
    count = len(ticks)
    positions = np.broadcast_to(position, (count, position.shape[-1]))
    result = np.empty((*positions.shape, *ticks.shape[2:]))
    ends = np.broadcast_to(last, count)
    rows = ticks.reshape(*ticks.shape[:2], -1)  # (C, K, 2 n)
    result_rows = result.reshape(*positions.shape, -1)

    def work(first: int, end: int) -> None:
        piece = slice(first, end)
        _interpolate_candidates(
            rows[piece], positions[piece], ends[piece], result_rows[piece]
        )

    parallel_for(work, count, CANDIDATES_PER_PIECE)
    return result


def interpolate_along_string(points: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Interpolate positions between the points of a curve, (C, F, M, 2).

    A place lies on the cubic through the four nearest points. Before the first point it
    lies on the straight line through the first two.

    points: (C, F, n, 2). place: (C, M) in numbers of points.
    """
    nodes = min(PLACE_NODES, points.shape[2])
    first = np.floor(place).astype(int) - (nodes // 2 - 1)
    first = np.clip(first, 0, points.shape[2] - nodes)
    offset = place - first
    straight = [1 - place, place, *[0 * place] * (nodes - 2)]
    weight = np.empty((*place.shape, nodes))
    for i in range(nodes):
        others = np.delete(np.arange(nodes), i)[:, None, None]
        cubic = np.prod((offset - others) / (i - others), axis=0)
        weight[..., i] = np.where(place < 0, straight[i], cubic)
    result = np.empty((*points.shape[:2], place.shape[1], 2))

    def work(start: int, end: int) -> None:
        piece = slice(start, end)
        _sum_weighted_points(points[piece], first[piece], weight[piece], result[piece])

    parallel_for(work, len(points), CANDIDATES_PER_PIECE)
    return result


@compile_kernel
def _sum_weighted_points(
    points: np.ndarray, first: np.ndarray, weight: np.ndarray, result: np.ndarray
) -> None:
    """Sum weighted points of each candidate.

    points: (C, F, n, 2). first: the first of the nodes of each place, (C, M). weight:
    weights of the nodes, (C, M, W). result: (C, F, M, 2), filled in place.
    """
    for c in range(len(points)):
        for f in range(points.shape[1]):
            for m in range(first.shape[1]):
                x, y = 0.0, 0.0
                for i in range(weight.shape[2]):
                    p = first[c, m] + i
                    x += weight[c, m, i] * points[c, f, p, 0]
                    y += weight[c, m, i] * points[c, f, p, 1]
                result[c, f, m, 0], result[c, f, m, 1] = x, y


@compile_kernel
def _lagrange_weight(offset: float, node: int, nodes: int) -> float:
    """Return Lagrange's weight of a unit-spaced node, at an offset from the first."""
    weight = 1.0
    for other in range(nodes):
        if other != node:
            weight *= (offset - other) / (node - other)
    return weight


@compile_kernel
def interpolate_measurements(
    points: np.ndarray, frame: np.ndarray, place: np.ndarray
) -> np.ndarray:
    """Interpolate positions of measured points, by the cubic through the nearest four.

    Parameters
    ----------
    points : ndarray of shape (C, F, n, 2)
        Simulated points.
    frame : ndarray of int, shape (N,)
        Frame of each measurement.
    place : ndarray of shape (N,)
        Place along the string, in numbers of points.

    Returns
    -------
    ndarray of shape (C, N, 2)
    """
    count, last = len(points), points.shape[2] - 1
    nodes = min(PLACE_NODES, last + 1)
    first = np.empty(len(place), dtype=np.int64)
    weight = np.empty((len(place), nodes))
    for k in range(len(place)):
        inside = min(max(place[k], 0.0), float(last))
        first[k] = min(max(int(inside) - 1, 0), last + 1 - nodes)
        for i in range(nodes):
            weight[k, i] = _lagrange_weight(inside - first[k], i, nodes)
    result = np.empty((count, len(place), 2))
    for c in range(count):
        for k in range(len(place)):
            x, y = 0.0, 0.0
            for i in range(nodes):
                x += weight[k, i] * points[c, frame[k], first[k] + i, 0]
                y += weight[k, i] * points[c, frame[k], first[k] + i, 1]
            result[c, k, 0], result[c, k, 1] = x, y
    return result


@compile_kernel
def interpolate_shares(
    points: np.ndarray, frame: np.ndarray, share: np.ndarray, start: np.ndarray
) -> np.ndarray:
    """Interpolate positions at shares of the length of a line that was read.

    The line starts where the hand was believed, and not where it is. So the string is
    extended, or cut, along its first segment, until it starts beside that place. The
    length of a segment is that of an arc which bends like its two ends.

    Parameters
    ----------
    points : ndarray of shape (C, F, n, 2)
        Simulated points.
    frame : ndarray of int, shape (N,)
        Frame of each measurement.
    share : ndarray of shape (N,)
        Length up to the measurement over the whole length, 0 to 1.
    start : ndarray of shape (N, 2)
        Start of the line in the frame of each measurement; NaN if the string starts it.

    Returns
    -------
    ndarray of shape (C, N, 2)
    """
    count, segments = len(points), points.shape[2] - 1
    nodes = min(PLACE_NODES, segments + 1)
    weight = np.zeros(PLACE_NODES)
    result = np.empty((count, len(share), 2))
    depth = np.zeros(segments + 1)  # length up to each point
    for c in range(count):
        segment = 0
        before = 0.0  # length of the line before the string
        for k in range(len(share)):
            line = points[c, frame[k]]
            if k == 0 or frame[k] != frame[k - 1]:
                _measure_arcs(line, depth)
                before = _length_before(line, start[k])
                segment = 0
            wanted = share[k] * (before + depth[segments]) - before
            if wanted < 0:
                factor = wanted / np.hypot(
                    line[1, 0] - line[0, 0], line[1, 1] - line[0, 1]
                )
                result[c, k] = line[0] + factor * (line[1] - line[0])
                continue
            while segment > 0 and depth[segment] > wanted:
                segment -= 1
            while segment < segments - 1 and depth[segment + 1] < wanted:
                segment += 1
            arc = depth[segment + 1] - depth[segment]
            inside = min(max((wanted - depth[segment]) / arc, 0.0), 1.0)
            first = min(max(segment - 1, 0), segments + 1 - nodes)
            _weigh_nodes(segment + inside - first, nodes, weight)
            x, y = 0.0, 0.0
            for i in range(nodes):
                x += weight[i] * line[first + i, 0]
                y += weight[i] * line[first + i, 1]
            result[c, k, 0], result[c, k, 1] = x, y
    return result


@compile_kernel
def _length_before(line: np.ndarray, start: np.ndarray) -> float:
    """Compute how far a start (2,) lies before a string (n, 2), along its beginning.

    It is 0 for an unknown start.
    """
    if np.isnan(start[0]):
        return 0.0
    dx, dy = line[1, 0] - line[0, 0], line[1, 1] - line[0, 1]
    ahead = (line[0, 0] - start[0]) * dx + (line[0, 1] - start[1]) * dy
    return ahead / np.hypot(dx, dy)


@compile_kernel
def _weigh_nodes(offset: float, nodes: int, weight: np.ndarray) -> None:
    """Fill `weight` (PLACE_NODES,) with the weights at an offset from the first node.

    For four nodes it takes a quarter of the time of `_lagrange_weight`.
    """
    if nodes == PLACE_NODES:
        a, b, c = offset - 1, offset - 2, offset - 3
        weight[0] = a * b * c * (-1 / 6)
        weight[1] = offset * b * c * 0.5
        weight[2] = offset * a * c * -0.5
        weight[3] = offset * a * b * (1 / 6)
        return
    for i in range(nodes):
        weight[i] = _lagrange_weight(offset, i, nodes)


@compile_kernel
def _measure_arcs(line: np.ndarray, depth: np.ndarray) -> None:
    """Fill `depth` (n,) with the length of a curve through points (n, 2)."""
    segments = len(line) - 1
    before = 0.0  # turn at the beginning of the segment, as a sine
    dx, dy = line[1, 0] - line[0, 0], line[1, 1] - line[0, 1]
    chord = np.sqrt(dx * dx + dy * dy)
    for k in range(segments):
        after = before
        next_dx, next_dy, next_chord = dx, dy, chord
        if k < segments - 1:
            next_dx = line[k + 2, 0] - line[k + 1, 0]
            next_dy = line[k + 2, 1] - line[k + 1, 1]
            next_chord = np.sqrt(next_dx * next_dx + next_dy * next_dy)
            after = (dx * next_dy - dy * next_dx) / (chord * next_chord)
        if k == 0:
            before = after
        bend = 0.5 * (before + after)
        depth[k + 1] = depth[k] + chord * (1 + bend * bend / 24)
        before = after
        dx, dy, chord = next_dx, next_dy, next_chord


@compile_kernel
def _interpolate_candidates(
    ticks: np.ndarray, position: np.ndarray, last: np.ndarray, result: np.ndarray
) -> None:
    """Interpolate each candidate between its ticks.

    ticks: (C, K, M). position: (C, F). last: (C,). result: (C, F, M), filled in place.
    """
    weight = np.empty(TIME_NODES)
    for c in range(len(ticks)):
        for f in range(position.shape[1]):
            first = int(np.floor(position[c, f])) - (TIME_NODES // 2 - 1)
            first = min(max(first, 0), last[c] + 1 - TIME_NODES)
            offset = position[c, f] - first
            for i in range(TIME_NODES):
                weight[i] = _lagrange_weight(offset, i, TIME_NODES)
            # The innermost loop runs over a whole tick, so that the compiler vectorises
            # it.
            row = result[c, f]
            row[:] = 0.0
            for i in range(TIME_NODES):
                tick = ticks[c, first + i]
                for m in range(len(row)):
                    row[m] += weight[i] * tick[m]
