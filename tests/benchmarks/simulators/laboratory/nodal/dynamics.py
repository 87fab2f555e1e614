"""A rod of cubic elements, compiled: its forces, and implicit steps in time.

Inner forces by virtual work, outer ones per unstretched length. Steps by Alexander's
diagonally implicit Runge-Kutta method of third order (SIAM J. Numer. Anal. 14, 1977),
stable for whatever is stiff and damps it (L-stable). Unknown in each stage are the
accelerations; Newton's matrix is banded, of element by element differences. All in one
file, for Numba's cache looks at no other.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from tests.benchmarks.simulators.laboratory.rod import Rod

SLOW = 0.05  # [m/s] of sliding below which Coulomb's friction is smooth
DIAGONAL = 0.4358665215084589994  # root of x^3 - 3 x^2 + 3/2 x - 1/6
STAGES = np.array(
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
MOMENTS = STAGES.sum(axis=1)  # of the stages, in a step
# coordinates beside a row that an element couples: four rows of two, less itself
BAND = 7
ENOUGH = 1e-9  # [m] of a correction in place
TRIES = 40  # corrections of a stage before its step is given up
# corrections after which the matrix is made again: it is kept from step to step while
# it serves
ANEW = 4


class Elements(NamedTuple):
    """Equal elements as compiled code takes them. shapes: (G, 3, 4) shape functions and
    two derivatives at the Gauss points. weights: (G,) [m]. places: (E, G) arc lengths
    of the Gauss points [m]. mass: (D, D) of one coordinate [m], and weight: (D, 2)
    [m2/s2], both over nominal mass per length.
    """

    shapes: np.ndarray
    weights: np.ndarray
    places: np.ndarray
    mass: np.ndarray
    weight: np.ndarray


class State(NamedTuple):
    """q, v: (D, 2) coordinates and their rates. inner: (E, G, 2) Bouc and Wen's state
    and Zener's at the Gauss points, before the rates have lasted for `lapse` [s].
    turned: angle of the first tangent from the grasp's direction at some time before,
    from which it is less than half a turn away [rad]: a rod may wind about its grasp.
    """

    q: np.ndarray
    v: np.ndarray
    inner: np.ndarray
    lapse: float
    turned: float


@njit(cache=True, error_model="numpy")
def stiffness(s: float, rod: Rod) -> float:
    """Bending stiffness at an arc length [m4/s2]."""
    even = rod.bending * (1.0 + rod.stiffness_taper * (s / rod.length - 0.5))
    if rod.soft_loss == 0.0:
        return even
    z = (s / rod.length - rod.soft_place) / 0.08
    return even * (1.0 - rod.soft_loss * math.exp(-z * z))


@njit(cache=True, error_model="numpy")
def moment(
    turn: float, rate: float, rubbed: float, relaxed: float, s: float, rod: Rod
) -> float:
    """Bending moment [m3/s2] of a turn [1/m] and its rate. rubbed: Bouc and Wen's state
    [1]. relaxed: Zener's [1/m].
    """
    bent = turn - rod.set_curvature
    hard = math.sqrt(1.0 + abs(rod.hardening) * bent * bent)
    elastic = stiffness(s, rod) * bent * (hard if rod.hardening > 0.0 else 1.0 / hard)
    return (
        elastic + rod.bending_damping * rate + rod.rub * rubbed + rod.relaxing * relaxed
    )


@njit(cache=True, error_model="numpy")
def air(x: float, y: float, t: float, rod: Rod) -> tuple[float, float]:
    """Velocity of the air [m/s]."""
    wx, wy = rod.wind_x, rod.wind_y
    if rod.gust_x != 0.0 or rod.gust_y != 0.0:
        z = (t - rod.gust_when) / rod.gust_lasts
        gust = math.exp(-z * z)
        wx, wy = wx + gust * rod.gust_x, wy + gust * rod.gust_y
    if rod.flutter_x != 0.0 or rod.flutter_y != 0.0:
        swing = math.sin(2.0 * math.pi * rod.flutter_frequency * t)
        wx, wy = wx + swing * rod.flutter_x, wy + swing * rod.flutter_y
    if rod.eddy != 0.0:
        dx, dy = (x - rod.eddy_x) / rod.eddy_core, (y - rod.eddy_y) / rod.eddy_core
        round_ = 1.65 * rod.eddy * math.exp(-0.5 * (dx * dx + dy * dy))
        wx, wy = wx - round_ * dy, wy + round_ * dx
    return wx, wy


@njit(cache=True, error_model="numpy")
def drag(ux: float, uy: float, tx: float, ty: float, rod: Rod) -> tuple[float, float]:
    """Force of the air on a string along t that moves through it with u [m/s2]; across
    it, the cross-flow principle.
    """
    speed = math.sqrt(ux * ux + uy * uy)
    even, more = rod.quadratic_drag * speed, 0.0
    if rod.crisis != 0.0:
        even *= 1.0 - 0.5 * rod.crisis * (
            1.0 + math.tanh((speed / rod.crisis_speed - 1.0) / 0.15)
        )
    even += rod.linear_drag
    along = ux * tx + uy * ty
    nx, ny = ux - along * tx, uy - along * ty
    if rod.across != 0.0:
        more = rod.across * (
            rod.linear_drag + rod.quadratic_drag * math.sqrt(nx * nx + ny * ny)
        )
    return -even * ux - more * nx, -even * uy - more * ny


@njit(cache=True, error_model="numpy")
def obstacles(
    x: float, y: float, vx: float, vy: float, rod: Rod
) -> tuple[float, float]:
    """Push of a plane, with friction and loss, and of a round peg [m/s2]."""
    fx = fy = 0.0
    depth = rod.plane_height - rod.plane_x * x - rod.plane_y * y
    if depth > 0.0:
        push = max(
            rod.plane * depth - rod.plane_loss * (rod.plane_x * vx + rod.plane_y * vy),
            0.0,
        )
        slide = rod.plane_y * vx - rod.plane_x * vy
        rub = rod.plane_friction * push * math.tanh(slide / SLOW)
        fx += push * rod.plane_x - rub * rod.plane_y
        fy += push * rod.plane_y + rub * rod.plane_x
    if rod.peg > 0.0:
        dx, dy = x - rod.peg_x, y - rod.peg_y
        away = max(math.hypot(dx, dy), 1e-9)
        inside = max(rod.peg_radius - away, 0.0)
        fx += rod.peg * inside * dx / away
        fy += rod.peg * inside * dy / away
    return fx, fy


@njit(cache=True, error_model="numpy")
def local(
    x: float, y: float, vx: float, vy: float, s: float, t: float, rod: Rod
) -> tuple[float, float]:
    """Loads that depend on place or time: a pull to a point, a blow, fingers that take
    hold [m/s2].
    """
    fx = fy = 0.0
    if rod.pull != 0.0:
        dx, dy = (rod.pull_x - x) / rod.pull_reach, (rod.pull_y - y) / rod.pull_reach
        pull = 1.65 * rod.pull * math.exp(-0.5 * (dx * dx + dy * dy))
        fx, fy = pull * dx, pull * dy
    if rod.blow_x != 0.0 or rod.blow_y != 0.0:
        z, w = (t - rod.blow_when) / 0.008, (s / rod.length - rod.blow_place) / 0.08
        blow = math.exp(-z * z - w * w)
        fx, fy = fx + blow * rod.blow_x, fy + blow * rod.blow_y
    if rod.hold != 0.0:
        begun, ended = (t - rod.hold_from) / 0.004, (t - rod.hold_until) / 0.004
        w = (s / rod.length - rod.hold_place) / 0.05
        brake = (
            0.25
            * rod.hold
            * (1.0 + math.tanh(begun))
            * (1.0 - math.tanh(ended))
            * math.exp(-w * w)
        )
        fx, fy = fx - brake * vx, fy - brake * vy
    return fx, fy


@njit(cache=True, error_model="numpy")
def load(
    x: float,
    y: float,
    vx: float,
    vy: float,
    tx: float,
    ty: float,
    s: float,
    t: float,
    rod: Rod,
) -> tuple[float, float]:
    """All outer forces but weight, per unstretched length and nominal mass [m/s2]."""
    wx, wy = air(x, y, t, rod)
    fx, fy = drag(vx - wx, vy - wy, tx, ty, rod)
    ox, oy = obstacles(x, y, vx, vy, rod)
    lx, ly = local(x, y, vx, vy, s, t, rod)
    return fx + ox + lx, fy + oy + ly


@njit(cache=True, error_model="numpy")
def at_tip(
    x: float, y: float, vx: float, vy: float, t: float, rod: Rod
) -> tuple[float, float]:
    """Forces at the tip: a flag in the air, a thread that goes taut [m2/s2]."""
    wx, wy = air(x, y, t, rod)
    ux, uy = vx - wx, vy - wy
    flag = rod.flag * math.sqrt(ux * ux + uy * uy)
    dx, dy = rod.thread_x - x, rod.thread_y - y
    far = max(math.hypot(dx, dy), 1e-9)
    taut = rod.thread * rod.length * max(far - rod.thread_slack, 0.0) / far
    return taut * dx - flag * ux, taut * dy - flag * uy


@njit(cache=True, error_model="numpy")
def grasp_moment(turn: float, rate: float, t: float, rod: Rod) -> float:
    """Moment [m3/s2] by which the first tangent is held. turn: its angle from the
    grasp's direction [rad].
    """
    lost = math.exp(-rod.grasp_loss * max(t - rod.grasp_loss_from, 0.0))
    return lost * (rod.grasp_stiffness * turn + rod.grasp_damping * rate)


@njit(cache=True, error_model="numpy")
def grasp_turn(q: np.ndarray, theta: float, before: float) -> float:
    """Angle of the first tangent of coordinates (D, 2) from the grasp's direction theta
    [rad], the nearest to one before.
    """
    c, s = math.cos(theta), math.sin(theta)
    turn = math.atan2(c * q[1, 1] - s * q[1, 0], c * q[1, 0] + s * q[1, 1])
    return turn + 2.0 * math.pi * round((before - turn) / (2.0 * math.pi))


@njit(cache=True, error_model="numpy")
def inner_states(
    rate: float, rubbed: float, relaxed: float, lapse: float, rod: Rod
) -> tuple[float, float]:
    """Bouc and Wen's state [1] and Zener's [1/m] after a rate of turn [1/(m s)] has
    lasted, implicitly.

    z' = w (1 - z^2) while it is driven on, z' = w while it is driven back, w = rate /
    rub_curvature; r' = rate - r / T.
    """
    onward = lapse * rate / rod.rub_curvature
    z = rubbed + onward
    if z * onward > 0.0:
        z = 2.0 * z / (1.0 + math.sqrt(1.0 + 4.0 * onward * z))
    return z, (relaxed + lapse * rate) / (1.0 + lapse / rod.relaxation)


@njit(cache=True, error_model="numpy")
def add_element_forces(
    e: int,
    t: float,
    now: State,
    hand: np.ndarray,
    rod: Rod,
    made: Elements,
    force: np.ndarray,
    after: np.ndarray,
) -> None:
    """Add the forces on element e's coordinates to `force` (D, 2), and those at the
    ends; note its inner states then in `after`. hand: (8,) x, y, vx, vy, ax, ay, theta,
    omega.
    """
    q, v = now.q, now.v
    for g in range(len(made.weights)):
        add_point_forces(e, g, t, now, rod, made, force, after)
    if e == len(made.places) - 1:
        tip = 2 * e + 2
        fx, fy = at_tip(q[tip, 0], q[tip, 1], v[tip, 0], v[tip, 1], t, rod)
        force[tip, 0] += fx
        force[tip, 1] += fy
    if e == 0:
        dx, dy = q[1, 0], q[1, 1]
        square = dx * dx + dy * dy
        turn = grasp_turn(q, hand[6], now.turned)
        rate = (dx * v[1, 1] - dy * v[1, 0]) / square - hand[7]
        held = grasp_moment(turn, rate, t, rod)
        force[1, 0] += held * dy / square
        force[1, 1] -= held * dx / square


@njit(cache=True, error_model="numpy")
def add_point_forces(
    e: int,
    g: int,
    t: float,
    now: State,
    rod: Rod,
    made: Elements,
    force: np.ndarray,
    after: np.ndarray,
) -> None:
    """A Gauss point's share of its element's forces: virtual work of stretch and turn,
    and loads.

    With r' and r'' by arc length s: stretch |r'| - 1, turn (r' x r'') / r'^2.
    """
    q, v, shapes, weight, s = (
        now.q,
        now.v,
        made.shapes,
        made.weights[g],
        made.places[e, g],
    )
    x, y = interpolated(shapes, g, 0, q, 2 * e)
    rx, ry = interpolated(shapes, g, 1, q, 2 * e)
    kx, ky = interpolated(shapes, g, 2, q, 2 * e)
    vx, vy = interpolated(shapes, g, 0, v, 2 * e)
    wx, wy = interpolated(shapes, g, 1, v, 2 * e)
    ox, oy = interpolated(shapes, g, 2, v, 2 * e)
    square = rx * rx + ry * ry
    long = math.sqrt(square)
    turn = (rx * ky - ry * kx) / square
    grown = (rx * wx + ry * wy) / square
    rate = (wx * ky - wy * kx + rx * oy - ry * ox) / square - 2.0 * turn * grown
    rubbed, relaxed = inner_states(
        rate, now.inner[e, g, 0], now.inner[e, g, 1], now.lapse, rod
    )
    after[e, g, 0], after[e, g, 1] = rubbed, relaxed
    bend = moment(turn, rate, rubbed, relaxed, s, rod)
    pull = rod.axial * (long - 1.0) + rod.axial_damping * grown * long
    fx, fy = load(x, y, vx, vy, rx / long, ry / long, s, t, rod)
    ax = pull * rx / long + bend * (ky - 2.0 * turn * rx) / square
    ay = pull * ry / long - bend * (kx + 2.0 * turn * ry) / square
    bx, by = -bend * ry / square, bend * rx / square
    for i in range(4):
        value, first, second = (
            weight * shapes[g, 0, i],
            weight * shapes[g, 1, i],
            weight * shapes[g, 2, i],
        )
        force[2 * e + i, 0] += value * fx - first * ax - second * bx
        force[2 * e + i, 1] += value * fy - first * ay - second * by


@njit(cache=True, error_model="numpy", inline="always")
def interpolated(
    shapes: np.ndarray, g: int, k: int, q: np.ndarray, d: int
) -> tuple[float, float]:
    """The k-th derivative at Gauss point g of what an element's coordinates, from row d
    of q on, interpolate.
    """
    x = y = 0.0
    for i in range(4):
        x += shapes[g, k, i] * q[d + i, 0]
        y += shapes[g, k, i] * q[d + i, 1]
    return x, y


@njit(cache=True, error_model="numpy")
def forces(
    t: float, now: State, hand: np.ndarray, rod: Rod, made: Elements, after: np.ndarray
) -> np.ndarray:
    """Forces (D, 2) on all coordinates. after: gets the inner states then, (E, G, 2)."""
    force = np.zeros_like(now.q)
    for e in range(len(made.places)):
        add_element_forces(e, t, now, hand, rod, made, force, after)
    return force


@njit(cache=True, error_model="numpy")
def tangent(
    t: float, now: State, by_place: float, hand: np.ndarray, rod: Rod, made: Elements
) -> np.ndarray:
    """Slopes of the forces (2 D, 2 BAND + 1): column BAND + j - i holds dF_i / dx_j.

    x moves the rates by `now.lapse` and the places by `by_place`; with a lapse of 0 the
    places alone.
    """
    q, v, lapse = now.q, now.v, now.lapse
    band = np.zeros((2 * len(q), 2 * BAND + 1))
    base, there, after = np.zeros_like(q), np.zeros_like(q), np.empty_like(now.inner)
    own, rate = q.copy(), v.copy()
    moved = State(own, rate, now.inner, lapse, now.turned)
    small = 1e-7 / by_place
    for e in range(len(made.places)):
        base[2 * e : 2 * e + 4] = 0.0
        add_element_forces(e, t, moved, hand, rod, made, base, after)
        for row in range(2 * e, 2 * e + 4):
            for c in range(2):
                own[row, c] += by_place * small
                rate[row, c] += lapse * small
                there[2 * e : 2 * e + 4] = 0.0
                add_element_forces(e, t, moved, hand, rod, made, there, after)
                for i in range(4 * e, 4 * e + 8):
                    band[i, BAND + 2 * row + c - i] += (
                        there[i // 2, i % 2] - base[i // 2, i % 2]
                    ) / small
                own[row, c], rate[row, c] = q[row, c], v[row, c]
    return band


@njit(cache=True, error_model="numpy")
def lu_factors(band: np.ndarray) -> np.ndarray:
    """LU factors of a banded matrix (R, 2 BAND + 1), in its place; masses rule it, so
    that no pivots are sought.
    """
    for k in range(len(band)):
        for i in range(k + 1, min(k + BAND + 1, len(band))):
            ratio = band[i, BAND + k - i] / band[k, BAND]
            band[i, BAND + k - i] = ratio
            for j in range(k + 1, min(k + BAND + 1, len(band))):
                band[i, BAND + j - i] -= ratio * band[k, BAND + j - k]
    return band


@njit(cache=True, error_model="numpy")
def lu_solution(factors: np.ndarray, right: np.ndarray) -> np.ndarray:
    """The solution (R,) with the factors of a banded matrix."""
    x = right.copy()
    for i in range(len(x)):
        for j in range(max(0, i - BAND), i):
            x[i] -= factors[i, BAND + j - i] * x[j]
    for i in range(len(x) - 1, -1, -1):
        for j in range(i + 1, min(i + BAND + 1, len(x))):
            x[i] -= factors[i, BAND + j - i] * x[j]
        x[i] /= factors[i, BAND]
    return x


@njit(cache=True, error_model="numpy")
def newton_matrix(
    t: float, now: State, hand: np.ndarray, rod: Rod, made: Elements
) -> np.ndarray:
    """Slopes of M a - F by the accelerations of a stage, banded as those of `tangent`."""
    band = -tangent(t, now, now.lapse * now.lapse, hand, rod, made)
    for i in range(len(band)):
        for j in range(max(0, i - BAND), min(len(band), i + BAND + 1)):
            band[i, BAND + j - i] += (
                made.mass[i // 2, j // 2] if (i - j) % 2 == 0 else 0.0
            )
    return band


@njit(cache=True, error_model="numpy")
def stage(
    t: float,
    begun: State,
    hand: np.ndarray,
    rod: Rod,
    made: Elements,
    a: np.ndarray,
    after: np.ndarray,
    factors: np.ndarray,
) -> bool:
    """Find accelerations a (D, 2) with M a = F(q + lapse (v + lapse a), v + lapse a);
    whether they were found.

    begun: the state without this stage's share. after: gets the inner states then.
    factors: of Newton's matrix from a step before, made anew where it serves no more.
    """
    q, v, inner, lapse, turned = begun
    a[0] = hand[4:6]
    for tried in range(TRIES):
        rate = v + lapse * a
        place = q + lapse * rate
        place[0], rate[0] = hand[0:2], hand[2:4]
        now = State(place, rate, inner, lapse, turned)
        if (tried > 0 and tried % ANEW == 0) or factors[0, BAND] == 0.0:
            factors[:] = lu_factors(newton_matrix(t, now, hand, rod, made)[2:])
        force = forces(t, now, hand, rod, made, after)
        left = force + made.weight - np.dot(made.mass, a)
        more = lu_solution(factors, left[1:].copy().reshape(-1)).reshape(-1, 2)
        a[1:] += more
        size = lapse * lapse * np.abs(more).max()
        if size < ENOUGH:
            return True
        if not size < 1e3:
            return False
    return False


@njit(cache=True, error_model="numpy")
def step(
    t: np.ndarray,
    dt: float,
    now: State,
    hand: np.ndarray,
    rod: Rod,
    made: Elements,
    slopes: tuple[np.ndarray, np.ndarray, np.ndarray],
    factors: np.ndarray,
) -> bool:
    """Take coordinates, rates and inner states a step further, in their place; whether
    every stage was solved.

    t: (3,) of the stages. now: its lapse is a stage's. hand: (3, 8). slopes: of these
    three at the stages, (3, ...) each, with accelerations from the step before to begin
    with.
    """
    q, v, state, lapse, turned = now
    rates, a, change = slopes
    after = np.empty_like(state)
    for i in range(3):
        place, rate, inner = q.copy(), v.copy(), state.copy()
        for j in range(i):
            share = dt * STAGES[i, j]
            place += share * rates[j]
            rate += share * a[j]
            inner += share * change[j]
        a[i] = a[i - 1]
        begun = State(place, rate, inner, lapse, turned)
        if not stage(t[i], begun, hand[i], rod, made, a[i], after, factors):
            return False
        rates[i] = rate + lapse * a[i]
        rates[i, 0] = hand[i, 2:4]
        change[i] = (after - inner) / lapse
    for i in range(3):
        share = dt * STAGES[2, i]
        q += share * rates[i]
        v += share * a[i]
        state += share * change[i]
    q[0], v[0] = hand[2, 0:2], hand[2, 2:4]
    return True


@njit(cache=True, error_model="numpy")
def integrate(
    begin: float, dt: float, q: np.ndarray, hand: np.ndarray, rod: Rod, made: Elements
) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates and rates at every step, (K + 1, D, 2) each, from rest; NaN from
    where a step fails.

    hand: (K, 3, 8), at the stages of each step.
    """
    v, state = np.zeros_like(q), np.zeros((*made.places.shape, 2))
    all_q, all_v = (
        np.full((len(hand) + 1, *q.shape), np.nan),
        np.full((len(hand) + 1, *q.shape), np.nan),
    )
    all_q[0], all_v[0] = q, v
    slopes = (
        np.empty((3, *q.shape)),
        np.zeros((3, *q.shape)),
        np.empty((3, *state.shape)),
    )
    factors, lapse = np.zeros((2 * len(q) - 2, 2 * BAND + 1)), DIAGONAL * dt
    turned = grasp_turn(q, hand[0, 0, 6], 0.0)
    for k in range(len(hand)):
        now = State(q, v, state, lapse, turned)
        if not step(
            begin + (k + MOMENTS) * dt, dt, now, hand[k], rod, made, slopes, factors
        ):
            return all_q, all_v
        turned = grasp_turn(q, hand[k, 2, 6], turned)
        all_q[k + 1], all_v[k + 1] = q, v
    return all_q, all_v
