"""Implicit steps in time of a rod of cubic elements, compiled.

Alexander's diagonally implicit Runge-Kutta method of third order (SIAM J. Numer. Anal.
14, 1977) is stable for whatever is stiff, and damps it (L-stable). The accelerations
are the unknowns of each stage; Newton's matrix is banded.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from tests.benchmarks.simulators.nodal.assembly import (
    HALF_BANDWIDTH,
    Elements,
    State,
    all_forces,
    force_slopes,
    grasp_turn,
)
from tests.benchmarks.simulators.rod import Rod

DIAGONAL = 0.4358665215084589994  # root of x^3 - 3 x^2 + 3/2 x - 1/6
STAGE_WEIGHTS = np.array(
    [
        [DIAGONAL, 0.0, 0.0],
        [(1 - DIAGONAL) / 2, DIAGONAL, 0.0],
        [
            -(6 * DIAGONAL**2 - 16 * DIAGONAL + 1) / 4,
            (6 * DIAGONAL**2 - 20 * DIAGONAL + 5) / 4,
            DIAGONAL,
        ],
    ]
)
STAGE_TIMES = STAGE_WEIGHTS.sum(axis=1)  # as shares of a step
TOLERANCE_M = 1e-9  # largest correction of a position
DIVERGED_M = 1e3
MAX_CORRECTIONS = 40  # corrections of a stage before its step is given up
MATRIX_LIFETIME = 4  # corrections after which Newton's matrix is computed again


@njit(cache=True, error_model="numpy")
def lu_factors(band: np.ndarray) -> np.ndarray:
    """Factorise a banded matrix (R, 2 HALF_BANDWIDTH + 1) in its place.

    Masses dominate it, so no pivots are needed.
    """
    rows = len(band)
    for k in range(rows):
        end = min(k + HALF_BANDWIDTH + 1, rows)
        for i in range(k + 1, end):
            ratio = band[i, HALF_BANDWIDTH + k - i] / band[k, HALF_BANDWIDTH]
            band[i, HALF_BANDWIDTH + k - i] = ratio
            for j in range(k + 1, end):
                change = ratio * band[k, HALF_BANDWIDTH + j - k]
                band[i, HALF_BANDWIDTH + j - i] -= change
    return band


@njit(cache=True, error_model="numpy")
def lu_solution(factors: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return the solution (R,) with the factors of a banded matrix."""
    x = right.copy()
    for i in range(len(x)):
        for j in range(max(0, i - HALF_BANDWIDTH), i):
            x[i] -= factors[i, HALF_BANDWIDTH + j - i] * x[j]
    for i in range(len(x) - 1, -1, -1):
        for j in range(i + 1, min(i + HALF_BANDWIDTH + 1, len(x))):
            x[i] -= factors[i, HALF_BANDWIDTH + j - i] * x[j]
        x[i] /= factors[i, HALF_BANDWIDTH]
    return x


@njit(cache=True, error_model="numpy")
def newton_matrix(
    t: float, state: State, hand: np.ndarray, rod: Rod, elements: Elements
) -> np.ndarray:
    """Return slopes of M a - F by the accelerations of a stage, banded."""
    place_lapse = state.lapse * state.lapse
    band = -force_slopes(t, state, place_lapse, hand, rod, elements)
    for i in range(len(band)):
        first = max(0, i - HALF_BANDWIDTH)
        for j in range(first, min(len(band), i + HALF_BANDWIDTH + 1)):
            if (i - j) % 2 == 0:
                band[i, HALF_BANDWIDTH + j - i] += elements.mass[i // 2, j // 2]
    return band


@njit(cache=True, error_model="numpy", inline="always")
def solve_stage(
    t: float,
    start: State,
    hand: np.ndarray,
    rod: Rod,
    elements: Elements,
    a: np.ndarray,
    memory: np.ndarray,
    factors: np.ndarray,
) -> bool:
    """Find accelerations a with M a = F(q + lapse (v + lapse a), v + lapse a).

    Parameters
    ----------
    t : time of the stage [s]
    start : the state without this stage's share
    hand : (8,) as `GraspPath.states`
    rod, elements : the string
    a : (D, 2), the first guess, and then the solution
    memory : (E, G, 2), to which the new states go
    factors : of Newton's matrix from an earlier step, renewed where they serve no more

    Returns
    -------
    Whether they were found.
    """
    q, v, memory_before, lapse, turned = start
    a[0] = hand[4:6]
    for corrections in range(MAX_CORRECTIONS):
        rate = v + lapse * a
        place = q + lapse * rate
        place[0], rate[0] = hand[0:2], hand[2:4]
        state = State(place, rate, memory_before, lapse, turned)
        is_old = corrections > 0 and corrections % MATRIX_LIFETIME == 0
        if is_old or factors[0, HALF_BANDWIDTH] == 0.0:
            matrix = newton_matrix(t, state, hand, rod, elements)
            factors[:] = lu_factors(matrix[2:])
        force = all_forces(t, state, hand, rod, elements, memory)
        residual = force + elements.weight - np.dot(elements.mass, a)
        correction = lu_solution(factors, residual[1:].copy().reshape(-1))
        correction = correction.reshape(-1, 2)
        a[1:] += correction
        size = lapse * lapse * np.abs(correction).max()
        if size < TOLERANCE_M:
            return True
        if not size < DIVERGED_M:
            return False
    return False


@njit(cache=True, error_model="numpy", inline="always")
def take_step(
    t: np.ndarray,
    dt: float,
    state: State,
    hand: np.ndarray,
    rod: Rod,
    elements: Elements,
    slopes: tuple[np.ndarray, np.ndarray, np.ndarray],
    factors: np.ndarray,
) -> bool:
    """Take a state a step further, in its place.

    Parameters
    ----------
    t : (3,) times of the stages [s]
    dt : step [s]
    state : its lapse is a stage's
    hand : (3, 8) at the stages
    rod, elements : the string
    slopes : of coordinates, rates and memory at the stages, (3, ...) each; at first
        with accelerations from the step before
    factors : of Newton's matrix

    Returns
    -------
    Whether every stage was solved.
    """
    q, v, memory, lapse, turned = state
    rates, accelerations, memory_rates = slopes
    memory_after = np.empty_like(memory)
    for i in range(3):
        place, rate, memory_start = q.copy(), v.copy(), memory.copy()
        for j in range(i):
            share = dt * STAGE_WEIGHTS[i, j]
            place += share * rates[j]
            rate += share * accelerations[j]
            memory_start += share * memory_rates[j]
        a = accelerations[i]
        a[:] = accelerations[i - 1]
        start = State(place, rate, memory_start, lapse, turned)
        if not solve_stage(
            t[i], start, hand[i], rod, elements, a, memory_after, factors
        ):
            return False
        rates[i] = rate + lapse * a
        rates[i, 0] = hand[i, 2:4]
        memory_rates[i] = (memory_after - memory_start) / lapse
    for i in range(3):
        share = dt * STAGE_WEIGHTS[2, i]
        q += share * rates[i]
        v += share * accelerations[i]
        memory += share * memory_rates[i]
    q[0], v[0] = hand[2, 0:2], hand[2, 2:4]
    return True


@njit(cache=True, error_model="numpy")
def integrate(
    begin: float,
    dt: float,
    q: np.ndarray,
    hand: np.ndarray,
    rod: Rod,
    elements: Elements,
) -> tuple[np.ndarray, np.ndarray]:
    """Return coordinates and rates at every step from rest, (K + 1, D, 2) each.

    They are NaN from where a step fails. `hand` (K, 3, 8) is at the stages of each
    step.
    """
    steps, coordinates = len(hand), len(q)
    v = np.zeros_like(q)
    memory = np.zeros((*elements.places.shape, 2))
    all_q = np.full((steps + 1, coordinates, 2), np.nan)
    all_v = np.full((steps + 1, coordinates, 2), np.nan)
    all_q[0], all_v[0] = q, v
    rates = np.empty((3, coordinates, 2))
    accelerations = np.zeros((3, coordinates, 2))
    memory_rates = np.empty((3, *memory.shape))
    slopes = rates, accelerations, memory_rates
    factors = np.zeros((2 * coordinates - 2, 2 * HALF_BANDWIDTH + 1))
    turned = grasp_turn(q, hand[0, 0, 6], 0.0)
    for k in range(steps):
        state = State(q, v, memory, DIAGONAL * dt, turned)
        t = begin + (k + STAGE_TIMES) * dt
        if not take_step(t, dt, state, hand[k], rod, elements, slopes, factors):
            return all_q, all_v
        turned = grasp_turn(q, hand[k, 2, 6], turned)
        all_q[k + 1], all_v[k + 1] = q, v
    return all_q, all_v
