"""Eq. 1 by hand, for one candidate: a plain Numba loop, in the paper's own parameters.

It shares no code with the engine. Each step is one pass along the string.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from stringcast.stages.model.hand import HandMotion

GRAVITY = 9.81


def path(hand: HandMotion, steps: int) -> np.ndarray:
    """Return the grasp at every step of a tick by Hermite's cubic, (ticks, steps, 6).

    Columns are x, y, theta and their rates.
    """
    u = (np.arange(steps) / steps)[:, None]
    (p0, p1), tick = (hand.pose[0, :-1, None], hand.pose[0, 1:, None]), hand.tick
    v0, v1 = hand.rate[0, :-1, None] * tick, hand.rate[0, 1:, None] * tick
    a2, a3 = 3 * (p1 - p0) - 2 * v0 - v1, 2 * (p0 - p1) + v0 + v1
    return np.concatenate(
        [p0 + u * (v0 + u * (a2 + u * a3)), (v0 + u * (2 * a2 + 3 * u * a3)) / tick],
        axis=-1,
    )


@njit(error_model="numpy", fastmath={"contract"})
def cast(
    start: np.ndarray,
    parameters: np.ndarray,
    length: float,
    hand: np.ndarray,
    tick: float,
) -> np.ndarray:
    """Simulate mass points; return their positions at the ticks, (ticks, n, 2) [m].

    `start` (n, 2) is at rest [m]. `parameters` are k_s, c_s, k_h, c_h, c_c1, c_c2,
    k_ph, c_ph, per unit mass of one mass point. `length` is that of a segment [m].
    `hand` is as in `path`. The integrator is semi-implicit Euler.
    """
    k_s, c_s, k_h, c_h, c_c1, c_c2, k_ph, c_ph = parameters
    n, (ticks, steps, _) = len(start), hand.shape
    dt = tick / steps
    x, y = start[:, 0].copy(), start[:, 1].copy()
    vx, vy = np.zeros(n), np.zeros(n)
    seen = np.empty((ticks, n, 2))
    for c in range(ticks):
        x[0], y[0] = hand[c, 0, :2]
        seen[c, :, 0], seen[c, :, 1] = x, y
        for q in range(steps):
            x[0], y[0], theta, vx[0], vy[0], turn = hand[c, q]
            # The hand's direction and rate are those of the segment before the first.
            ux, uy, w = np.cos(theta), np.sin(theta), turn
            stiff, damp = k_ph, c_ph
            # quantities of the segment before
            px, py, pull, inverse, moment = 0.0, 0.0, 0.0, 0.0, 0.0
            fx, fy = 0.0, 0.0  # its force on the point at its end
            for i in range(n):
                before, gx, gy = moment, fx, fy
                if i < n - 1:
                    ex, ey = x[i + 1] - x[i], y[i + 1] - y[i]
                    rx, ry = vx[i + 1] - vx[i], vy[i + 1] - vy[i]
                    size = np.sqrt(ex * ex + ey * ey)
                    tx, ty = ex / size, ey / size
                    omega = (tx * ry - ty * rx) / size
                    angle = np.arctan2(ux * ty - uy * tx, ux * tx + uy * ty)
                    # F_h, F_b; at the hand F_ph, F_phc
                    moment = stiff * angle + damp * (omega - w)
                    # F_s, F_d
                    tension = k_s * (size - length) + c_s * (tx * rx + ty * ry)
                else:
                    moment, size, tx, ty, omega, tension = 0.0, 1.0, 0.0, 0.0, 0.0, 0.0
                # The moments at both ends of the segment before are known now, and so
                # its force.
                fx = -pull * px - (moment - before) * inverse * py
                fy = -pull * py + (moment - before) * inverse * px
                if i > 1:
                    _move(i - 1, x, y, vx, vy, gx - fx, gy - fy, c_c1, c_c2, dt)
                px, py, pull, inverse = tx, ty, tension, 1.0 / size
                ux, uy, w, stiff, damp = tx, ty, omega, k_h, c_h
            _move(n - 1, x, y, vx, vy, fx, fy, c_c1, c_c2, dt)
    return seen


@njit(error_model="numpy", fastmath={"contract"}, inline="always")
def _move(i, x, y, vx, vy, fx, fy, c_c1, c_c2, dt):  # type: ignore[no-untyped-def]
    """Step point i under its neighbours' forces, air (F_c) and gravity (F_g)."""
    drag = c_c1 + c_c2 * np.sqrt(vx[i] * vx[i] + vy[i] * vy[i])
    vx[i] += dt * (fx - drag * vx[i])
    vy[i] += dt * (fy - drag * vy[i] - GRAVITY)
    x[i] += dt * vx[i]
    y[i] += dt * vy[i]
