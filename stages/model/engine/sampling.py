"""Positions between the ticks of a simulation, and between its mass points."""

from __future__ import annotations

import numpy as np
from numba import njit

from stringcast.stages.model.engine.threads import parallel_for

TIME_NODES = 6  # ticks that the polynomial goes through
PLACE_NODES = 4  # mass points that the curve between them goes through
TICK_TOLERANCE = 1e-6  # of a tick, which is as good as none
MAX_TIP_DISTANCE_M = 1e3  # [m] where no tip is
# candidates that are worth a thread: what is done with each of them takes ten
# microseconds and more
CANDIDATES_PER_PIECE = 128


def last_needed_tick(position: np.ndarray) -> np.ndarray:
    """The last tick that each candidate asks for, (C,), or one for all, (1,): what is
    simulated longer for others must not matter. position: (F,) or (C, F) in ticks.
    """
    return np.maximum(
        np.ceil(np.atleast_2d(position).max(axis=1) - 1e-9).astype(int), TIME_NODES - 1
    )


def is_bounded(ticks: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Whether candidates have their tip within a kilometre until their last tick, (C,).
    ticks: (C, K, n, 2); last: (C,) or (1,).
    """
    with np.errstate(invalid="ignore", over="ignore"):
        within = np.abs(ticks[:, :, -1]).sum(axis=-1) < MAX_TIP_DISTANCE_M
    return np.asarray(
        (within | (np.arange(ticks.shape[1]) > last[:, None])).all(axis=1)
    )


def interpolate_ticks(
    ticks: np.ndarray, position: np.ndarray, last: np.ndarray
) -> np.ndarray:
    """Positions between ticks, by Lagrange's polynomial through the six nearest.

    ticks: (C, K, n, 2). position: (F,) or (C, F) in ticks, of which those before the
    first count as it. last: as `asked`. (C, F, n, 2).
    """
    position = np.maximum(position, 0)
    whole = np.round(position)
    # where the polynomial is a tick to the bit
    position = np.where(np.abs(position - whole) < TICK_TOLERANCE, whole, position)
    if position.ndim == 1 and np.array_equal(position, whole):
        whole = whole.astype(int)
        return (
            ticks
            if np.array_equal(whole, np.arange(ticks.shape[1]))
            else ticks[:, whole]
        )
    each = np.broadcast_to(position, (len(ticks), position.shape[-1]))
    result = np.zeros((*each.shape, *ticks.shape[2:]))
    ends = np.broadcast_to(last, len(ticks))
    parallel_for(
        lambda one, end: _interpolate_candidates(
            ticks, each, ends, TIME_NODES, one, end, result
        ),
        len(ticks),
        CANDIDATES_PER_PIECE,
    )
    return result


def interpolate_along_string(points: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Places between the points of a curve, by the cubic through the four nearest, and
    straight on before the first.

    points: (C, F, n, 2). place: (C, M) in numbers of points. (C, F, M, 2).
    """
    width = min(PLACE_NODES, points.shape[2])
    first = np.clip(
        np.floor(place).astype(int) - (width // 2 - 1), 0, points.shape[2] - width
    )
    weight = np.empty((*place.shape, width))
    for i in range(width):
        others = np.array([m for m in range(width) if m != i])
        cubic = np.prod(
            (place - first - others[:, None, None]) / (i - others[:, None, None]),
            axis=0,
        )
        straight = (1 - place, place, *[0 * place] * (width - 2))[i]
        weight[..., i] = np.where(place < 0, straight, cubic)
    result = np.zeros((*points.shape[:2], place.shape[1], 2))
    parallel_for(
        lambda one, end: _sum_weighted_points(points, first, weight, one, end, result),
        len(points),
        CANDIDATES_PER_PIECE,
    )
    return result


@njit(nogil=True, cache=True, error_model="numpy")
def _sum_weighted_points(
    points: np.ndarray,
    first: np.ndarray,
    weight: np.ndarray,
    one: int,
    end: int,
    result: np.ndarray,
) -> None:
    """Candidates from one to before end. points: (C, F, n, 2). first: of the points
    that each place lies between, (C, M); weight: of these, (C, M, W). result: zeros (C,
    F, M, 2), filled in place.
    """
    for c in range(one, end):
        for f in range(points.shape[1]):
            for m in range(first.shape[1]):
                for i in range(weight.shape[2]):
                    result[c, f, m, 0] += (
                        weight[c, m, i] * points[c, f, first[c, m] + i, 0]
                    )
                    result[c, f, m, 1] += (
                        weight[c, m, i] * points[c, f, first[c, m] + i, 1]
                    )


@njit(nogil=True, cache=True, error_model="numpy")
def interpolate_measurements(
    points: np.ndarray, frame: np.ndarray, place: np.ndarray
) -> np.ndarray:
    """Positions of the measured places, by the cubic through the four mass points
    nearest, (C, N, 2).

    points: (C, F, n, 2). frame: (N,) in which each is measured; place: (N,) in numbers
    of points.
    """
    count, last = len(points), points.shape[2] - 1
    nodes = min(PLACE_NODES, last + 1)
    result, weight = np.zeros((count, len(place), 2)), np.empty(nodes)
    for k in range(len(place)):
        at = min(max(place[k], 0.0), float(last))
        first = min(max(int(at) - 1, 0), last + 1 - nodes)
        for i in range(nodes):
            weight[i] = 1.0
            for m in range(nodes):
                if m != i:
                    weight[i] *= (at - first - m) / (i - m)
        for c in range(count):
            for i in range(nodes):
                result[c, k, 0] += weight[i] * points[c, frame[k], first + i, 0]
                result[c, k, 1] += weight[i] * points[c, frame[k], first + i, 1]
    return result


@njit(nogil=True, cache=True, error_model="numpy")
def _interpolate_candidates(
    ticks: np.ndarray,
    position: np.ndarray,
    last: np.ndarray,
    width: int,
    one: int,
    end: int,
    result: np.ndarray,
) -> None:
    """Candidates from one to before end. ticks: (C, K, n, 2); position: (C, F); last:
    (C,); width: nodes of the polynomial; result: zeros (C, F, n, 2), filled in place.
    """
    for c in range(one, end):
        for f in range(position.shape[1]):
            first = min(
                max(int(np.floor(position[c, f])) - (width // 2 - 1), 0),
                last[c] + 1 - width,
            )
            offset = position[c, f] - first
            for i in range(width):
                weight = 1.0
                for m in range(width):
                    if m != i:
                        weight *= (offset - m) / (i - m)
                for p in range(ticks.shape[2]):
                    result[c, f, p, 0] += weight * ticks[c, first + i, p, 0]
                    result[c, f, p, 1] += weight * ticks[c, first + i, p, 1]
