"""Eq. 1 by hand, for many candidates side by side: what the engine's generated loop is
measured against.

Written for these eight forces and nothing else: masses are all alike, the hand's poses
are looked up. A point's quantities lie together (rows of W candidates), so that the
distance of any two is known at compile time and LLVM fills the vector units.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from stringcast.stages.model.engine.rotation import ATAN_COEFFICIENTS_TO_HALF
from tests.speed.scalar import GRAVITY

W = 16
KINDS = 15
X, Y, VX, VY, ANGLE, EX, EY, TX, TY, INVERSE, PULL, OMEGA, MOMENT, FX, FY = (
    np.uintp(W * i) for i in range(KINDS)
)
# from a point's row to the next point's, a segment's to the next's
NEXT = np.uintp(W * KINDS)
WIDTH = np.uintp(W)
ONE, TWO = np.uintp(1), np.uintp(2)
A0, A1, A2, A3, A4, A5, A6, A7 = ATAN_COEFFICIENTS_TO_HALF
K_S, C_S, K_H, C_H, C_C1, C_C2, K_PH, C_PH = (np.uintp(W * i) for i in range(8))
LANE = {
    "error_model": "numpy",
    "fastmath": {"contract"},
    "boundscheck": False,
    "forceinline": True,
}


@njit(**LANE)
def segment(B, P, k, j, length):  # type: ignore[no-untyped-def]
    """Measure the segment that starts at row k: its angle and turning rate; what else
    is needed later stays in B.
    """
    ex, ey = B[NEXT + X + k] - B[X + k], B[NEXT + Y + k] - B[Y + k]
    rx, ry = B[NEXT + VX + k] - B[VX + k], B[NEXT + VY + k] - B[VY + k]
    cross, dot = B[EX + k] * ey - B[EY + k] * ex, B[EX + k] * ex + B[EY + k] * ey
    size = np.sqrt(ex * ex + ey * ey)
    inverse, d = 1.0 / size, cross / dot
    d2 = d * d
    turn = d * (
        A0
        + d2
        * (A1 + d2 * (A2 + d2 * (A3 + d2 * (A4 + d2 * (A5 + d2 * (A6 + d2 * A7))))))
    )
    angle = B[ANGLE + k] + turn
    tx, ty = ex * inverse, ey * inverse
    omega = (tx * ry - ty * rx) * inverse
    B[PULL + k] = P[K_S + j] * (size - length) + P[C_S + j] * (tx * rx + ty * ry)
    B[EX + k], B[EY + k], B[TX + k], B[TY + k], B[INVERSE + k] = ex, ey, tx, ty, inverse
    B[ANGLE + k], B[OMEGA + k] = angle, omega
    return angle, omega


@njit(**LANE)
def force(B, p, couple):  # type: ignore[no-untyped-def]
    """Force of the segment at row p on the point at its start, less its sign."""
    twist = (couple - B[MOMENT + p]) * B[INVERSE + p]
    fx = -B[PULL + p] * B[TX + p] - twist * B[TY + p]
    fy = -B[PULL + p] * B[TY + p] + twist * B[TX + p]
    B[FX + p], B[FY + p] = fx, fy
    return fx, fy


@njit(**LANE)
def move(B, P, p, j, fx, fy, dt):  # type: ignore[no-untyped-def]
    """One step of semi-implicit Euler of the point at row p."""
    qx, qy = B[VX + p], B[VY + p]
    drag = P[C_C1 + j] + P[C_C2 + j] * np.sqrt(qx * qx + qy * qy)
    qx += dt * (B[FX + p - NEXT] - fx - drag * qx)
    qy += dt * (B[FY + p - NEXT] - fy - drag * qy - GRAVITY)
    B[X + p] += dt * qx
    B[Y + p] += dt * qy
    B[VX + p], B[VY + p] = qx, qy


@njit(**LANE)
def step(B, P, n, length, dt, theta, turn):  # type: ignore[no-untyped-def]
    """All points of one block one step."""
    for j in range(WIDTH):
        angle, omega = segment(B, P, j, j, length)
        B[MOMENT + j] = P[K_PH + j] * (angle - theta) + P[C_PH + j] * (omega - turn)
    for j in range(WIDTH):
        k = NEXT + j
        angle, omega = segment(B, P, k, j, length)
        couple = P[K_H + j] * (angle - B[ANGLE + j]) + P[C_H + j] * (
            omega - B[OMEGA + j]
        )
        B[MOMENT + k] = couple
        force(B, j, couple)
    for i in range(TWO, n - ONE):
        for j in range(WIDTH):
            k = i * NEXT + j
            p = k - NEXT
            angle, omega = segment(B, P, k, j, length)
            couple = P[K_H + j] * (angle - B[ANGLE + p]) + P[C_H + j] * (
                omega - B[OMEGA + p]
            )
            B[MOMENT + k] = couple
            fx, fy = force(B, p, couple)
            move(B, P, p, j, fx, fy, dt)
    for j in range(WIDTH):
        p = (n - TWO) * NEXT + j
        fx, fy = force(B, p, 0.0)
        move(B, P, p, j, fx, fy, dt)
    for j in range(WIDTH):
        move(B, P, (n - ONE) * NEXT + j, j, 0.0, 0.0, dt)


@njit(parallel=True, error_model="numpy", fastmath={"contract"}, boundscheck=False)
def cast(rows, parameters, points, length, hand, tick, seen):  # type: ignore[no-untyped-def]
    """Positions at the beginning of each tick in `seen` (blocks, ticks, 2, n, W) [m].

    rows: (blocks, n * KINDS * W) initial state, overwritten, see `state`. parameters:
    (blocks, 8 * W), in the order of Eq. 1. length: of a segment [m]. hand: see
    `scalar.path`.
    """
    for b in prange(rows.shape[0]):
        B, P, n = rows[b], parameters[b], np.uintp(points)
        ticks, steps, _ = hand.shape
        for c in range(ticks):
            for q in range(steps):
                for j in range(WIDTH):
                    B[X + j], B[Y + j], B[VX + j], B[VY + j] = (
                        hand[c, q, 0],
                        hand[c, q, 1],
                        hand[c, q, 3],
                        hand[c, q, 4],
                    )
                if q == 0:
                    for i in range(n):
                        for j in range(WIDTH):
                            seen[b, c, 0, i, j] = B[i * NEXT + X + j]
                            seen[b, c, 1, i, j] = B[i * NEXT + Y + j]
                step(B, P, n, length, tick / steps, hand[c, q, 2], hand[c, q, 5])


def state(start: np.ndarray, blocks: int) -> np.ndarray:
    """Rows of so many blocks of the same string at rest. start: (n, 2) [m]."""
    edges = np.diff(start, axis=0, append=start[-1:])
    rows = np.zeros((blocks, len(start), KINDS, W))
    angle = np.unwrap(np.arctan2(edges[:-1, 1], edges[:-1, 0]))
    for kind, values in (
        (X, start[:, 0]),
        (Y, start[:, 1]),
        (EX, edges[:, 0]),
        (EY, edges[:, 1]),
    ):
        rows[:, :, kind // WIDTH] = values[None, :, None]
    rows[:, :-1, ANGLE // WIDTH] = angle[None, :, None]
    return rows.reshape(blocks, -1)
