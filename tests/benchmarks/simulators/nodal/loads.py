"""Material law and loads of the rod, compiled: per unstretched length and nominal mass.

The PyElastica simulator shares the loads.
"""

from __future__ import annotations

import math

from numba import njit

from tests.benchmarks.simulators.rod import Rod

SLOW_SLIDING = 0.05  # [m/s] below which Coulomb's friction is smooth
# Lengths and times over which local causes act; `own_kernel_effects.py` repeats them.
SOFT_SPOT_M = 0.025
BLOW_M = 0.025
BLOW_S = 0.008
GRIP_M = 0.015
GRIP_EDGE_S = 0.004
PEAK = 1.65  # makes the largest value of x exp(-x^2 / 2) one


@njit(cache=True, error_model="numpy")
def bending_stiffness(s: float, rod: Rod) -> float:
    """Return the bending stiffness at an arc length [m4/s2]."""
    tapered = rod.bending * (1.0 + rod.stiffness_taper * (s / rod.length - 0.5))
    if rod.soft_spot == 0.0:
        return tapered
    z = (s - rod.soft_spot_place) / SOFT_SPOT_M
    return tapered * (1.0 - rod.soft_spot * math.exp(-z * z))


@njit(cache=True, error_model="numpy")
def bending_moment(
    turn: float, rate: float, friction: float, relaxing: float, s: float, rod: Rod
) -> float:
    """Return the bending moment [m3/s2] of a turn [1/m] and its rate.

    `friction` is Bouc and Wen's state [1], `relaxing` is Zener's state [1/m].
    """
    bent = turn - rod.rest_curvature
    hardening = math.sqrt(1.0 + abs(rod.hardening) * bent * bent)
    if rod.hardening <= 0.0:
        hardening = 1.0 / hardening
    elastic = bending_stiffness(s, rod) * bent * hardening
    with_damping = elastic + rod.bending_damping * rate
    return with_damping + rod.friction * friction + rod.relaxing_stiffness * relaxing


@njit(cache=True, error_model="numpy")
def update_memory(
    rate: float, friction: float, relaxing: float, lapse: float, rod: Rod
) -> tuple[float, float]:
    """Return Bouc and Wen's state [1] and Zener's [1/m] after a lapse, implicitly.

    With w = rate / friction_curvature, z' = w (1 - z^2) while the hinge is driven on,
    and z' = w while it is driven back; r' = rate - r / relaxation_time.
    """
    onward = lapse * rate / rod.friction_curvature
    z = friction + onward
    if z * onward > 0.0:
        z = 2.0 * z / (1.0 + math.sqrt(1.0 + 4.0 * onward * z))
    return z, (relaxing + lapse * rate) / (1.0 + lapse / rod.relaxation_time)


@njit(cache=True, error_model="numpy")
def air_velocity(x: float, y: float, t: float, rod: Rod) -> tuple[float, float]:
    """Return the velocity of the air [m/s]."""
    wx, wy = rod.wind_x, rod.wind_y
    if rod.gust_x != 0.0 or rod.gust_y != 0.0:
        z = (t - rod.gust_when) / rod.gust_lasts
        gust = math.exp(-z * z)
        wx += gust * rod.gust_x
        wy += gust * rod.gust_y
    if rod.flutter_x != 0.0 or rod.flutter_y != 0.0:
        wave = math.sin(2.0 * math.pi * rod.flutter_frequency * t)
        wx += wave * rod.flutter_x
        wy += wave * rod.flutter_y
    if rod.vortex != 0.0:
        dx = (x - rod.vortex_x) / rod.vortex_core
        dy = (y - rod.vortex_y) / rod.vortex_core
        speed = PEAK * rod.vortex * math.exp(-0.5 * (dx * dx + dy * dy))
        wx -= speed * dy
        wy += speed * dx
    return wx, wy


@njit(cache=True, error_model="numpy")
def drag(ux: float, uy: float, tx: float, ty: float, rod: Rod) -> tuple[float, float]:
    """Return the force of the air on a string along t that moves through it with u.

    The force across the string [m/s2] follows the cross-flow principle.
    """
    speed = math.sqrt(ux * ux + uy * uy)
    resistance = rod.quadratic_drag * speed
    if rod.drag_drop != 0.0:
        above = 1.0 + math.tanh((speed / rod.drag_drop_speed - 1.0) / 0.15)
        resistance *= 1.0 - 0.5 * rod.drag_drop * above
    resistance += rod.linear_drag
    along = ux * tx + uy * ty
    nx, ny = ux - along * tx, uy - along * ty
    across = 0.0
    if rod.cross_drag != 0.0:
        speed_across = math.sqrt(nx * nx + ny * ny)
        across = rod.linear_drag + rod.quadratic_drag * speed_across
        across *= rod.cross_drag
    return -resistance * ux - across * nx, -resistance * uy - across * ny


@njit(cache=True, error_model="numpy")
def obstacle_force(
    x: float, y: float, vx: float, vy: float, rod: Rod
) -> tuple[float, float]:
    """Return the push of a plane, with friction and loss, and of a round peg [m/s2]."""
    fx = fy = 0.0
    depth = rod.plane_height - rod.plane_x * x - rod.plane_y * y
    if depth > 0.0:
        leaving = rod.plane_x * vx + rod.plane_y * vy
        push = max(rod.plane * depth - rod.plane_loss * leaving, 0.0)
        sliding = rod.plane_y * vx - rod.plane_x * vy
        friction = rod.plane_friction * push * math.tanh(sliding / SLOW_SLIDING)
        fx += push * rod.plane_x - friction * rod.plane_y
        fy += push * rod.plane_y + friction * rod.plane_x
    if rod.peg > 0.0:
        dx, dy = x - rod.peg_x, y - rod.peg_y
        distance = max(math.hypot(dx, dy), 1e-9)
        depth = max(rod.peg_radius - distance, 0.0)
        fx += rod.peg * depth * dx / distance
        fy += rod.peg * depth * dy / distance
    return fx, fy


@njit(cache=True, error_model="numpy")
def local_force(
    x: float, y: float, vx: float, vy: float, s: float, t: float, rod: Rod
) -> tuple[float, float]:
    """Return an attraction to a point, a blow, and the brake of a grip [m/s2]."""
    fx = fy = 0.0
    if rod.attraction != 0.0:
        dx = (rod.attraction_x - x) / rod.attraction_reach
        dy = (rod.attraction_y - y) / rod.attraction_reach
        force = PEAK * rod.attraction * math.exp(-0.5 * (dx * dx + dy * dy))
        fx, fy = force * dx, force * dy
    if rod.blow_x != 0.0 or rod.blow_y != 0.0:
        z, w = (t - rod.blow_when) / BLOW_S, (s - rod.blow_place) / BLOW_M
        share = math.exp(-z * z - w * w)
        fx, fy = fx + share * rod.blow_x, fy + share * rod.blow_y
    if rod.grip != 0.0:
        since = 1.0 + math.tanh((t - rod.grip_from) / GRIP_EDGE_S)
        until = 1.0 - math.tanh((t - rod.grip_until) / GRIP_EDGE_S)
        w = (s - rod.grip_place) / GRIP_M
        brake = 0.25 * rod.grip * since * until * math.exp(-w * w)
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
    """Return all outer forces but weight [m/s2]."""
    wx, wy = air_velocity(x, y, t, rod)
    drag_x, drag_y = drag(vx - wx, vy - wy, tx, ty, rod)
    push_x, push_y = obstacle_force(x, y, vx, vy, rod)
    local_x, local_y = local_force(x, y, vx, vy, s, t, rod)
    return drag_x + push_x + local_x, drag_y + push_y + local_y


@njit(cache=True, error_model="numpy")
def tip_force(
    x: float, y: float, vx: float, vy: float, t: float, rod: Rod
) -> tuple[float, float]:
    """Return the forces at the tip: a flag in the air and a taut thread [m2/s2]."""
    wx, wy = air_velocity(x, y, t, rod)
    ux, uy = vx - wx, vy - wy
    resistance = rod.flag * math.sqrt(ux * ux + uy * uy)
    dx, dy = rod.thread_x - x, rod.thread_y - y
    distance = max(math.hypot(dx, dy), 1e-9)
    stretch = max(distance - rod.thread_slack, 0.0) / distance
    tension = rod.thread * rod.length * stretch
    return tension * dx - resistance * ux, tension * dy - resistance * uy


@njit(cache=True, error_model="numpy")
def grasp_moment(turn: float, rate: float, t: float, rod: Rod) -> float:
    """Return the moment [m3/s2] that holds the first tangent.

    `turn` is its angle from the grasp's direction [rad].
    """
    remaining = math.exp(-rod.grasp_loss * max(t - rod.grasp_loss_from, 0.0))
    return remaining * (rod.grasp_stiffness * turn + rod.grasp_damping * rate)
