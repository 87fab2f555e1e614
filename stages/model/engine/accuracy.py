"""Find number of points and step for a tolerance of the tip, by refinement.

The error follows from Richardson extrapolation. If one refinement by two moves the tip
by c d, and the next by d, the error between them is d c / (c - 1), for errors that
shrink like a power. c is measured and limited by the method's order. If the moves do
not shrink, there is no estimate, and the refinement continues.
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

# Each count is twice the one before the last.
SEGMENT_COUNTS = (5, 7, 10, 14, 20, 28, 40, 56, 80, 112)
LEVELS_TO_HALVE_STEP = 4  # 1.2^4 = 2.07
COARSEST_STEP_LEVEL = 5  # level of the largest step tried: 3 steps in a tick
ORDER_IN_POINTS = 2  # of the error in the length of a segment
POINT_ERROR_SHARE = 0.75  # of the tolerance

# A string, and the moves of the tip by its last and next refinement, (C,) [m].
Refinement = tuple[String, np.ndarray, np.ndarray]


class ToleranceError(ValueError):
    """The tolerance cannot be kept; the message has measured errors and remedies."""


@dataclass(frozen=True)
class ConvergedString:
    """A string with an error of the tip within a tolerance.

    Parameters
    ----------
    string : String
        The string.
    point_error_m, step_error_m : float
        Measured errors of the tip by the number of points and by the step [m].
    """

    string: String
    point_error_m: float
    step_error_m: float


def find_converged_string(
    string: String, hand: HandMotion, values: np.ndarray, tolerance: float
) -> ConvergedString:
    """Find the fewest points and then the largest step that keep a tolerance.

    Most of the tolerance goes to the number of points, which costs more time.

    Parameters
    ----------
    string : String
        The string to refine.
    hand : HandMotion
        As in `simulate`.
    values : ndarray of shape (C, P)
        As in `simulate`.
    tolerance : float
        Largest error of the tip of any candidate at any tick [m].

    Raises
    ------
    ToleranceError
        If no mesh or no step keeps it.
    """
    meshes = _refine_points(string, hand, values)
    mesh, point_error = _first_within_tolerance(
        meshes, POINT_ERROR_SHARE * tolerance, ORDER_IN_POINTS, "points"
    )
    converged, step_error = _first_within_tolerance(
        _refine_steps(mesh, hand, values),
        tolerance - point_error,
        string.integrator.order,
        "steps",
    )
    return ConvergedString(converged, point_error, step_error)


def _first_within_tolerance(
    refinements: Iterator[Refinement], tolerance: float, order: int, refined_part: str
) -> tuple[String, float]:
    """Return the first string with an error within the tolerance, and the error."""
    smallest = np.inf
    for string, before, after in refinements:
        error = float(remaining_error(before, after, order).max())
        if error <= tolerance:
            return string, error
        smallest = min(smallest, error)
    raise ToleranceError(
        f"the tip cannot be kept within {tolerance * 1e3:.3g} mm by more "
        f"{refined_part}: the best measured is {smallest * 1e3:.3g} mm. Allow more, "
        "choose a gentler motion or a string with more damping, set tip_cell and "
        "grasp_cell to 0.5, or take an integrator without a stability limit "
        "(stages.model.engine.implicit_leapfrog.ImplicitLeapfrog)."
    )


def remaining_error(before: np.ndarray, after: np.ndarray, order: int) -> np.ndarray:
    """Estimate the error [m] of a result from its refinements, in any shape.

    The last refinement moved the result by `before`, and the next moves it by `after`.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        shrink = np.minimum(before / after, 2.0**order)
        error = np.where(shrink > 1, after * shrink / (shrink - 1), np.inf)
    return np.where(after == 0, 0.0, error)


def richardson_limit(
    coarse: np.ndarray, fine: np.ndarray, order: int = ORDER_IN_POINTS
) -> np.ndarray:
    """Extrapolate two results to their limit, in any shape.

    The fine result has twice the number of parts or half the step.
    """
    return fine + (fine - coarse) / (2**order - 1)


def _refine_points(
    string: String, hand: HandMotion, values: np.ndarray
) -> Iterator[Refinement]:
    """Yield strings with an increasing number of segments."""
    strings = [replace(string, points=count + 1) for count in SEGMENT_COUNTS]

    @cache
    def tip(k: int) -> np.ndarray:
        return _simulate_tip(strings[k], hand, values)

    for k in range(2, len(strings) - 2):
        before = _max_distance(tip(k - 2), tip(k))
        yield strings[k], before, _max_distance(tip(k), tip(k + 2))


def _refine_steps(
    string: String, hand: HandMotion, values: np.ndarray
) -> Iterator[Refinement]:
    """Yield strings with decreasing steps, from the largest stable for all."""
    unlimited = replace(string, largest_step=hand.tick)
    material = string.material(np.atleast_2d(values))
    needed, _ = steps_per_tick(unlimited, material, hand.tick)
    stable = np.log(needed.max()) / np.log(STEP_SIZE_RATIO)
    level = max(COARSEST_STEP_LEVEL, int(np.ceil(stable - 1e-9)))

    def with_level(level: int) -> String:
        return replace(string, largest_step=hand.tick / STEP_SIZE_RATIO**level)

    coarse = with_level(level)
    tip = _simulate_tip(coarse, hand, values)
    before = None
    while True:
        fine = with_level(level + LEVELS_TO_HALVE_STEP)
        fine_tip = _simulate_tip(fine, hand, values)
        after = _max_distance(tip, fine_tip)
        # Coarser steps are unstable, so the first refinement counts as first order.
        yield coarse, 2 * after if before is None else before, after
        if STEP_SIZE_RATIO ** (level + 2 * LEVELS_TO_HALVE_STEP) >= MAX_STEPS_PER_TICK:
            return
        level += LEVELS_TO_HALVE_STEP
        coarse, tip, before = fine, fine_tip, after


def _simulate_tip(string: String, hand: HandMotion, values: np.ndarray) -> np.ndarray:
    """Simulate the tip at the hand's ticks, (C, F, 2) [m]."""
    return simulate(string, hand, values, hand.times).tip


def _max_distance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the largest distance at any time, (C,) [m].

    It is infinite where a run was rejected.
    """
    distance = np.linalg.norm(a - b, axis=-1).max(axis=1)
    return np.nan_to_num(distance, nan=np.inf)
