"""Number of points and step for a wanted accuracy of the tip, measured by refinement.

Richardson: when a refinement by two moves the tip by d, after the one before had moved
it c times as far, the error that is left before it is d c / (c - 1), for errors that
shrink like a power. c is measured, and not believed beyond the method's order; where
the moves do not shrink there is no estimate, and refinement goes on.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from stringcast.stages.model.engine.simulate import simulate
from stringcast.stages.model.engine.stability import (
    MAX_STEPS_PER_TICK,
    STEP_SIZE_RATIO,
    steps_per_tick,
)
from stringcast.stages.model.hand import HandMotion
from stringcast.stages.model.string import String

# each twice the one before the last
SEGMENT_COUNTS = (5, 7, 10, 14, 20, 28, 40, 56, 80, 112)
LEVELS_TO_HALVE_STEP = 4  # levels of steps that halve it, nearly: 1.2^4 = 2.07
COARSEST_STEP_LEVEL = 5  # level of the largest step tried: 3 steps in a tick
ORDER_IN_POINTS = 2  # of the error in the length of a segment
POINT_ERROR_SHARE = 0.75  # of the tolerance


class ToleranceError(ValueError):
    """The tolerance cannot be kept; the message says what was measured and what may
    help.
    """


@dataclass(frozen=True)
class ConvergedString:
    """A string that keeps a tolerance. in_points, in_step: its errors of the tip, as
    measured [m].
    """

    string: String
    point_error_m: float
    step_error_m: float


def find_converged_string(
    string: String, hand: HandMotion, values: np.ndarray, tolerance: float
) -> ConvergedString:
    """The string with the fewest points and then the largest step that keep the tip
    within `tolerance` [m].

    hand, values (C, P): as in `simulate`; the largest error of any candidate at any
    tick counts. Most of the tolerance goes to the number of points, the dearer of the
    two. Raises ToleranceError.
    """
    share = POINT_ERROR_SHARE * tolerance
    coarse, in_points = _first_within_tolerance(
        _refine_points(string, hand, values), share, ORDER_IN_POINTS, "points"
    )
    rest = tolerance - in_points
    chosen, in_step = _first_within_tolerance(
        _refine_steps(coarse, hand, values), rest, string.integrator.order, "steps"
    )
    return ConvergedString(chosen, in_points, in_step)


def _first_within_tolerance(
    levels: Iterator[tuple[String, np.ndarray, np.ndarray]],
    tolerance: float,
    order: int,
    what: str,
) -> tuple[String, float]:
    """The first string whose error keeps the tolerance, and that error."""
    smallest = np.inf
    for string, before, after in levels:
        error = float(remaining_error(before, after, order).max())
        if error <= tolerance:
            return string, error
        smallest = min(smallest, error)
    raise ToleranceError(
        f"the tip cannot be kept within {tolerance * 1e3:.3g} mm by more {what}: the best measured is "
        f"{smallest * 1e3:.3g} mm. Allow more, choose a gentler motion or a string with more damping, set tip_cell "
        "and grasp_cell to 0.5, or an integrator without a stability limit (stages.model.engine.implicit_leapfrog.ImplicitLeapfrog)."
    )


def remaining_error(before: np.ndarray, after: np.ndarray, order: int) -> np.ndarray:
    """Error [m] of a result that moved by `before` when refined last and will move by
    `after` next. Any shape.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        shrink = np.minimum(before / after, 2.0**order)
        error = np.where(shrink > 1, after * shrink / (shrink - 1), np.inf)
    return np.where(after == 0, 0.0, error)


def richardson_limit(
    coarse: np.ndarray, fine: np.ndarray, order: int = ORDER_IN_POINTS
) -> np.ndarray:
    """Richardson's limit of two results of any shape, the second with twice as many
    parts and half the step.
    """
    return fine + (fine - coarse) / (2**order - 1)


def _refine_points(
    string: String, hand: HandMotion, values: np.ndarray
) -> Iterator[tuple[String, np.ndarray, np.ndarray]]:
    """Strings of more and more segments, with how far half and twice as many move the
    tip, (C,) each.
    """
    strings = [replace(string, points=count + 1) for count in SEGMENT_COUNTS]
    tip = cache(lambda k: _simulate_tip(strings[k], hand, values))
    for k in range(2, len(SEGMENT_COUNTS) - 2):
        yield (
            strings[k],
            _max_distance(tip(k - 2), tip(k)),
            _max_distance(tip(k), tip(k + 2)),
        )


def _refine_steps(
    string: String, hand: HandMotion, values: np.ndarray
) -> Iterator[tuple[String, np.ndarray, np.ndarray]]:
    """Strings of smaller and smaller steps, from the largest that all candidates allow;
    likewise.
    """
    free = replace(string, largest_step=hand.tick)
    needed, _ = steps_per_tick(free, string.material(np.atleast_2d(values)), hand.tick)
    level = max(
        COARSEST_STEP_LEVEL,
        int(np.ceil(np.log(needed.max()) / np.log(STEP_SIZE_RATIO) - 1e-9)),
    )

    def at(level: int) -> String:
        return replace(string, largest_step=hand.tick / STEP_SIZE_RATIO**level)

    tips = [
        _simulate_tip(at(level), hand, values),
        _simulate_tip(at(level + LEVELS_TO_HALVE_STEP), hand, values),
    ]
    after = _max_distance(*tips)
    # nothing coarser is stable: taken as of first order
    yield at(level), 2 * after, after
    while STEP_SIZE_RATIO ** (level + 2 * LEVELS_TO_HALVE_STEP) < MAX_STEPS_PER_TICK:
        level += LEVELS_TO_HALVE_STEP
        tips = [tips[1], _simulate_tip(at(level + LEVELS_TO_HALVE_STEP), hand, values)]
        before, after = after, _max_distance(*tips)
        yield at(level), before, after


def _simulate_tip(string: String, hand: HandMotion, values: np.ndarray) -> np.ndarray:
    """(C, F, 2) at the hand's ticks [m]."""
    times = hand.start + hand.tick * np.arange(hand.pose.shape[1])
    return simulate(string, hand, values, times).tip


def _max_distance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Largest distance at any time, (C,) [m]; infinite where a run was rejected."""
    return np.nan_to_num(np.linalg.norm(a - b, axis=-1).max(axis=1), nan=np.inf)
