"""Forces on a rod of cubic elements and their slopes, compiled.

Inner forces follow from virtual work, outer ones act per unstretched length.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from tests.benchmarks.simulators.nodal.loads import (
    bending_moment,
    grasp_moment,
    load,
    tip_force,
    update_memory,
)
from tests.benchmarks.simulators.rod import Rod

# Coordinates next to a row that an element couples: four rows of two, less itself.
HALF_BANDWIDTH = 7
SLOPE_STEP = 1e-7


class Elements(NamedTuple):
    """Equal elements as compiled code takes them.

    Parameters
    ----------
    shapes : (G, 3, 4) shape functions and two derivatives at the Gauss points
    weights : (G,) of the Gauss points [m]
    places : (E, G) their arc lengths [m]
    mass : (D, D) of one coordinate over nominal mass per length [m]
    weight : (D, 2) gravity over nominal mass per length [m2/s2]
    """

    shapes: np.ndarray
    weights: np.ndarray
    places: np.ndarray
    mass: np.ndarray
    weight: np.ndarray


class State(NamedTuple):
    """The rod at one time.

    Parameters
    ----------
    q, v : (D, 2) nodal coordinates and their rates
    memory : (E, G, 2) Bouc and Wen's state and Zener's at the Gauss points, before the
        rates have lasted for `lapse`
    lapse : [s]
    turned : angle of the first tangent from the grasp's direction [rad] a little
        earlier, for a rod may wind about its grasp
    """

    q: np.ndarray
    v: np.ndarray
    memory: np.ndarray
    lapse: float
    turned: float


@njit(cache=True, error_model="numpy")
def grasp_turn(q: np.ndarray, theta: float, before: float) -> float:
    """Return the angle of the first tangent from the grasp's direction theta [rad].

    Of all angles that differ by whole turns it is the nearest to the one before.
    """
    cosine, sine = math.cos(theta), math.sin(theta)
    along = cosine * q[1, 0] + sine * q[1, 1]
    across = cosine * q[1, 1] - sine * q[1, 0]
    turn = math.atan2(across, along)
    return turn + 2.0 * math.pi * round((before - turn) / (2.0 * math.pi))


@njit(cache=True, error_model="numpy")
def add_element_forces(
    e: int,
    t: float,
    state: State,
    hand: np.ndarray,
    rod: Rod,
    elements: Elements,
    force: np.ndarray,
    memory: np.ndarray,
) -> None:
    """Add the forces on element e's coordinates to `force` (D, 2), and those at ends.

    `hand` (8,) is as in `GraspPath.states`. The new states go to `memory` (E, G, 2).
    """
    q, v = state.q, state.v
    for g in range(len(elements.weights)):
        add_point_forces(e, g, t, state, rod, elements, force, memory)
    if e == len(elements.places) - 1:
        tip = 2 * e + 2
        fx, fy = tip_force(q[tip, 0], q[tip, 1], v[tip, 0], v[tip, 1], t, rod)
        force[tip, 0] += fx
        force[tip, 1] += fy
    if e == 0:
        dx, dy = q[1, 0], q[1, 1]
        square = dx * dx + dy * dy
        turn = grasp_turn(q, hand[6], state.turned)
        rate = (dx * v[1, 1] - dy * v[1, 0]) / square - hand[7]
        moment = grasp_moment(turn, rate, t, rod)
        force[1, 0] += moment * dy / square
        force[1, 1] -= moment * dx / square


@njit(cache=True, error_model="numpy")
def add_point_forces(
    e: int,
    g: int,
    t: float,
    state: State,
    rod: Rod,
    elements: Elements,
    force: np.ndarray,
    memory: np.ndarray,
) -> None:
    """Add a Gauss point's share: virtual work of stretch and turn, and loads.

    With r' and r'' by arc length s: stretch |r'| - 1, turn (r' x r'') / r'^2.
    """
    q, v, shapes = state.q, state.v, elements.shapes
    weight, s = elements.weights[g], elements.places[e, g]
    # place, slope, second derivative and their rates
    x, y = interpolate(shapes, g, 0, q, 2 * e)
    rx, ry = interpolate(shapes, g, 1, q, 2 * e)
    kx, ky = interpolate(shapes, g, 2, q, 2 * e)
    vx, vy = interpolate(shapes, g, 0, v, 2 * e)
    wx, wy = interpolate(shapes, g, 1, v, 2 * e)
    ox, oy = interpolate(shapes, g, 2, v, 2 * e)

    square = rx * rx + ry * ry
    length = math.sqrt(square)
    turn = (rx * ky - ry * kx) / square
    stretch_rate = (rx * wx + ry * wy) / square
    rate = (wx * ky - wy * kx + rx * oy - ry * ox) / square - 2.0 * turn * stretch_rate
    friction, relaxing = update_memory(
        rate, state.memory[e, g, 0], state.memory[e, g, 1], state.lapse, rod
    )
    memory[e, g, 0], memory[e, g, 1] = friction, relaxing
    moment = bending_moment(turn, rate, friction, relaxing, s, rod)
    tension = rod.axial * (length - 1.0) + rod.axial_damping * stretch_rate * length
    fx, fy = load(x, y, vx, vy, rx / length, ry / length, s, t, rod)

    # forces that do work on r' and on r''
    ax = tension * rx / length + moment * (ky - 2.0 * turn * rx) / square
    ay = tension * ry / length - moment * (kx + 2.0 * turn * ry) / square
    bx, by = -moment * ry / square, moment * rx / square
    for i in range(4):
        value = weight * shapes[g, 0, i]
        first = weight * shapes[g, 1, i]
        second = weight * shapes[g, 2, i]
        force[2 * e + i, 0] += value * fx - first * ax - second * bx
        force[2 * e + i, 1] += value * fy - first * ay - second * by


@njit(cache=True, error_model="numpy", inline="always")
def interpolate(
    shapes: np.ndarray, g: int, k: int, q: np.ndarray, row: int
) -> tuple[float, float]:
    """Return the k-th derivative at Gauss point g of coordinates from a row on."""
    x = y = 0.0
    for i in range(4):
        x += shapes[g, k, i] * q[row + i, 0]
        y += shapes[g, k, i] * q[row + i, 1]
    return x, y


@njit(cache=True, error_model="numpy")
def all_forces(
    t: float,
    state: State,
    hand: np.ndarray,
    rod: Rod,
    elements: Elements,
    memory: np.ndarray,
) -> np.ndarray:
    """Return the forces (D, 2) on all coordinates; new states go to `memory`."""
    force = np.zeros_like(state.q)
    for e in range(len(elements.places)):
        add_element_forces(e, t, state, hand, rod, elements, force, memory)
    return force


@njit(cache=True, error_model="numpy")
def force_slopes(
    t: float,
    state: State,
    place_lapse: float,
    hand: np.ndarray,
    rod: Rod,
    elements: Elements,
) -> np.ndarray:
    """Return slopes of the forces, a band (2 D, 2 HALF_BANDWIDTH + 1).

    Column HALF_BANDWIDTH + j - i holds dF_i / dx_j, where x moves the places by
    `place_lapse` and the rates by `state.lapse`.
    """
    q, v, lapse = state.q, state.v, state.lapse
    band = np.zeros((2 * len(q), 2 * HALF_BANDWIDTH + 1))
    force, moved_force = np.zeros_like(q), np.zeros_like(q)
    memory = np.empty_like(state.memory)
    moved_q, moved_v = q.copy(), v.copy()
    moved = State(moved_q, moved_v, state.memory, lapse, state.turned)
    step = SLOPE_STEP / place_lapse
    for e in range(len(elements.places)):
        force[2 * e : 2 * e + 4] = 0.0
        add_element_forces(e, t, moved, hand, rod, elements, force, memory)
        for row in range(2 * e, 2 * e + 4):
            for c in range(2):
                moved_q[row, c] += place_lapse * step
                moved_v[row, c] += lapse * step
                moved_force[2 * e : 2 * e + 4] = 0.0
                add_element_forces(
                    e, t, moved, hand, rod, elements, moved_force, memory
                )
                j = 2 * row + c
                for i in range(4 * e, 4 * e + 8):
                    change = moved_force[i // 2, i % 2] - force[i // 2, i % 2]
                    band[i, HALF_BANDWIDTH + j - i] += change / step
                moved_q[row, c], moved_v[row, c] = q[row, c], v[row, c]
    return band
