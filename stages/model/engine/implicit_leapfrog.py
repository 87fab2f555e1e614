"""A time step without a stability limit: leapfrog, with the linear forces averaged over
the step.

Velocities belong to the middles of the steps, v = v(t - dt/2), and change by

    M (v' - v) = dt f(x, v) - (dt/2 C + dt^2/4 K) (v' - v),    x' = x + dt v',

where f has all forces at the step's start and C, K are the damping and stiffness of
what is linear in the tension, moment and grasp-moment laws, along and across the
segments as they lie. For linear forces this is the trapezoidal rule (Newmark's beta =
1/4, gamma = 1/2 on the staggered grid): second order, stable at any step, and without
damping of its own. The air sees the velocity extrapolated by half a step, and is second
order too. What of a law is not linear stays explicit and bounds the step, as in the
other methods. What hinges have per curvature (a bending that hardens) is averaged with
what it is at the step's start, and bounds nothing. What hinges and the grasp hold is
averaged with its steepest rise, that where they turn back: an upper bound is stable,
and off by a term of second order where it is less.

With D the difference along the string, t and n = rotated t the directions of a segment,
r its length and e = n / r how its angle turns with its end, the matrix is

    M + sum_k D_k' [A t t' + (dt^2/4 T+ / r) n n'] D_k + sum_h B_h (e_h D_h - e_{h-1}
    D_{h-1})' (same),

with A, B the averaged axial and bending slopes and T+ the tension where it pulls. It is
symmetric, positive definite, and couples a point to two neighbours on each side, to the
second one by a product of two vectors only: eliminated from the grasp to the tip in
blocks of two by two, W candidates at a time, without branches or pivots.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from textwrap import indent

import numpy as np

from stringcast.stages.model.engine import rotation
from stringcast.stages.model.engine.integrators import Integrator, Slopes

MAX_BEND_PER_STEP = 10.0  # [1/m] by which a hinge may bend in a step

# Rows: mass of a point [m]; A (one row) and B of each hinge, and B as it is always; e;
# the matrix of a segment S; then, with D the eliminated diagonal block: U the block to
# the next point, Q = D^-1 U, z = D^-1 e, and the change of velocity, which is first the
# acceleration. Rows that nothing is written to are zero: all beyond the tip, and U, Q
# and z of the grasp.
SOLVER_ROWS = (
    *("MASS", "AXIAL", "BEND", "STEADY", "EX", "EY", "S11", "S12", "S22"),
    *("U11", "U12", "U21", "U22", "Q11", "Q12", "Q21", "Q22", "ZX", "ZY", "DVX", "DVY"),
)

# What the second point before leaves at a point; there is none before the first, which
# is taken by itself, for rows at distances known when compiling are what the vector
# units need.
SECOND_NEIGHBOUR_TERMS = """
ex = B[EX + p - NEXT]
ey = B[EY + p - NEXT]
bend = B[BEND + p]
turn = bend * bend * (ex * B[ZX + p - NEXT] + ey * B[ZY + p - NEXT])
spin = bend * (ex * B[DVX + p - NEXT] + ey * B[DVY + p - NEXT])
"""

ELIMINATION = """
# what the two points before leave here
u11 = B[U11 + p]
u12 = B[U12 + p]
u21 = B[U21 + p]
u22 = B[U22 + p]
bx = B[EX + p]
by = B[EY + p]
heft = B[MASS + k] * dt
rx = heft * B[DVX + k] - u11 * B[DVX + p] - u21 * B[DVY + p] - spin * bx
ry = heft * B[DVY + k] - u12 * B[DVX + p] - u22 * B[DVY + p] - spin * by
# the diagonal block
ex = B[EX + k]
ey = B[EY + k]
bend = B[BEND + k]
d11 = B[MASS + k] + B[S11 + p] + B[S11 + k] + 2.0 * bend * bx * ex - turn * bx * bx
d12 = B[S12 + p] + B[S12 + k] + bend * (bx * ey + by * ex) - turn * bx * by
d22 = B[MASS + k] + B[S22 + p] + B[S22 + k] + 2.0 * bend * by * ey - turn * by * by
d11 -= u11 * B[Q11 + p] + u21 * B[Q21 + p]
d12 -= u11 * B[Q12 + p] + u21 * B[Q22 + p]
d22 -= u12 * B[Q12 + p] + u22 * B[Q22 + p]
# the block to the next point
bx = bend * (bx + u11 * B[ZX + p] + u21 * B[ZY + p])
by = bend * (by + u12 * B[ZX + p] + u22 * B[ZY + p])
cx = B[BEND + k + NEXT] * B[EX + k + NEXT]
cy = B[BEND + k + NEXT] * B[EY + k + NEXT]
u11 = -B[S11 + k] - bx * ex - cx * ex
u12 = -B[S12 + k] - bx * ey - cy * ex
u21 = -B[S12 + k] - by * ex - cx * ey
u22 = -B[S22 + k] - by * ey - cy * ey
inverse = 1.0 / (d11 * d22 - d12 * d12)
d11 *= inverse
d12 *= inverse
d22 *= inverse
B[U11 + k] = u11
B[U12 + k] = u12
B[U21 + k] = u21
B[U22 + k] = u22
B[Q11 + k] = d22 * u11 - d12 * u21
B[Q12 + k] = d22 * u12 - d12 * u22
B[Q21 + k] = d11 * u21 - d12 * u11
B[Q22 + k] = d11 * u22 - d12 * u12
B[ZX + k] = d22 * ex - d12 * ey
B[ZY + k] = d11 * ey - d12 * ex
B[DVX + k] = d22 * rx - d12 * ry
B[DVY + k] = d11 * ry - d12 * rx
"""

BLOCK_SOLVE = f"""
# Change of all velocities under averaged linear forces, then of all positions.
for i in range(n - ONE):
    for j in range(W):
        k = i * NEXT + j
        tx = B[TX + k]
        ty = B[TY + k]
        inverse = B[INVERSE + k]
        pull = B[PULL + k] if B[PULL + k] > 0.0 else 0.0
        along = B[AXIAL + j]
        across = (0.25 * dt * dt * pull + (B[BEND + k] + B[BEND + k + NEXT]) * inverse) * inverse
        B[EX + k] = -ty * inverse
        B[EY + k] = tx * inverse
        B[S11 + k] = along * tx * tx + across * ty * ty
        B[S12 + k] = (along - across) * tx * ty
        B[S22 + k] = along * ty * ty + across * tx * tx
for j in range(W):
    k = NEXT + j
    p = j
    turn = 0.0
    spin = 0.0
{indent(ELIMINATION, 4 * " ")}
for i in range(TWO, n):
    for j in range(W):
        k = i * NEXT + j
        p = k - NEXT
{indent(SECOND_NEIGHBOUR_TERMS + ELIMINATION, 8 * " ")}
for i in range(ONE, n):
    for j in range(W):
        k = (n - i) * NEXT + j
        m = k + NEXT
        turn = B[BEND + m] * (B[EX + m] * B[DVX + m + NEXT] + B[EY + m] * B[DVY + m + NEXT])
        dvx = B[DVX + k] - B[Q11 + k] * B[DVX + m] - B[Q12 + k] * B[DVY + m] - turn * B[ZX + k]
        dvy = B[DVY + k] - B[Q21 + k] * B[DVX + m] - B[Q22 + k] * B[DVY + m] - turn * B[ZY + k]
        vx = B[VX + k] + dvx
        vy = B[VY + k] + dvy
        B[DVX + k] = dvx
        B[DVY + k] = dvy
        B[VX + k] = vx
        B[VY + k] = vy
        B[X + k] += dt * vx
        B[Y + k] += dt * vy
"""


@dataclass(frozen=True)
class ImplicitLeapfrog(Integrator):
    """Leapfrog with the linear part of the inner forces averaged over the step: see the
    module.
    """

    name: str = "implicit_leapfrog"
    stage_times: tuple[float, ...] = (0.0,)
    order: int = 2
    update_source: tuple[str, ...] = (
        "B[DVX + p] = ax",
        "B[DVY + p] = ay",
        "qx = B[VX + p]",
        "qy = B[VY + p]",
    )
    velocity_lag: float = 0.5
    row_names: tuple[str, ...] = SOLVER_ROWS
    velocity_source: tuple[str, ...] = (
        "qx = B[VX + p] + 0.5 * B[DVX + p]",
        "qy = B[VY + p] + 0.5 * B[DVY + p]",
    )
    averaged_slots: tuple[str, ...] = (
        "hinge_stiffness",
        "held_moment",
        "grasp_held_moment",
    )
    turn_source: str = field(default=rotation.ANY_TURN_SOURCE, repr=False)
    solve_source: str = field(default=BLOCK_SOLVE, repr=False)

    def step_limiting_slope(
        self, steepest: np.ndarray, gentlest: np.ndarray
    ) -> np.ndarray:
        """The slope beyond the linear part, (C,)."""
        return steepest - gentlest

    def hinge_source(
        self, slots: Sequence[str], law: Callable[[str, str], str]
    ) -> list[str]:
        """The averaged slope with what the laws add to it: of a stiffness twice, for
        what hardens is that much steeper than it is stiff, and as it is where the hinge
        may be bent to in this step.
        """
        if "hinge_stiffness" not in slots:
            return []
        stiffness = law("hinge_stiffness", f"abs(curvature) + {MAX_BEND_PER_STEP}")
        return [
            f"B[BEND + k] = B[STEADY + k] + (0.5 * dt * dt * max({stiffness}, 0.0)) * over"
        ]

    def largest_stable_step(
        self, frequency2: np.ndarray, damping: np.ndarray, drag: np.ndarray
    ) -> np.ndarray:
        """Leapfrog's for what is not linear; extrapolated drag c alone needs c dt < 1."""
        c = damping.sum(axis=0) + 2.0 * drag
        return 4.0 / np.maximum(
            c + np.sqrt(c**2 + 4.0 * frequency2.sum(axis=0)), 1e-300
        )

    def row_values(
        self, masses: np.ndarray, segment: np.ndarray, slopes: Slopes, dt: float
    ) -> Mapping[str, np.ndarray]:
        """Masses and averaged slopes: dt/2 of the damping and dt^2/4 of the stiffness,
        by which a change acts.
        """
        stiffness, damping = slopes()
        axial, bending, grasp = (0.5 * dt * damping + 0.25 * dt**2 * stiffness)[
            ..., None
        ]
        hinges = np.repeat(bending / segment[:, None], masses.shape[1] - 2, axis=1)
        bend = np.concatenate([grasp, hinges], axis=1)
        return {
            "MASS": masses,
            "AXIAL": axial / segment[:, None],
            "BEND": bend,
            "STEADY": bend,
        }
