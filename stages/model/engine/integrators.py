"""Time steps of the string engine: each is the few lines that move one mass point.

A step is one or more passes over the string. `update` is source text that the kernel
generator places where the acceleration (ax, ay) of a point is known; it sees its
position px, py, its velocity qx, qy, the step dt, and rows of its own to keep things
in. A method that moves the points together only keeps the acceleration, and moves them
after the pass (`solve`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from stringcast.stages.model.engine import rotation

Slopes = Callable[
    [], tuple[np.ndarray, np.ndarray]
]  # stiffness and damping, axial, in bending and at the grasp, (3, C)


@dataclass(frozen=True)
class Integrator:
    """nodes: when in a step the forces are evaluated, in steps, one for each pass.
    order: of convergence. update: source text, a line a string. behind: how far the
    velocities that it keeps are behind the positions, in steps. rows: names of rows of
    its own. velocity: source text of the velocity qx, qy that loads see. averaged:
    slots of what is per curvature that bound no step, since `hinge` averages them as
    they are. turned: how a segment's turn in a step is measured. solve: source text of
    what runs after each pass.
    """

    name: str
    stage_times: tuple[float, ...]
    order: int
    update_source: tuple[str, ...]
    velocity_lag: float = 0.0
    row_names: tuple[str, ...] = ()
    velocity_source: tuple[str, ...] = ("qx = B[VX + p]", "qy = B[VY + p]")
    averaged_slots: tuple[str, ...] = ()
    turn_source: str = field(default=rotation.SMALL_TURN_SOURCE, repr=False)
    solve_source: str = field(default="", repr=False)

    def largest_stable_step(
        self, frequency2: np.ndarray, damping: np.ndarray, drag: np.ndarray
    ) -> np.ndarray:
        """Largest stable step [s], (C,).

        frequency2 [1/s^2], damping [1/s]: (M, C) bounds for M kinds of motion, whose
        sums bound all together. drag [1/s]: (C,) the most that air adds.
        """
        raise NotImplementedError

    def step_limiting_slope(
        self, steepest: np.ndarray, gentlest: np.ndarray
    ) -> np.ndarray:
        """The part of a law's slope that limits the step: all of it. steepest,
        gentlest: (C,) over the string's range.
        """
        return steepest

    def hinge_source(
        self, slots: Sequence[str], law: Callable[[str, str], str]
    ) -> list[str]:
        """Source text of what becomes of a hinge with laws in these slots, which are
        per curvature.

        law: the text of a slot's laws at an argument.
        """
        return []

    def row_values(
        self, masses: np.ndarray, segment: np.ndarray, slopes: Slopes, dt: float
    ) -> Mapping[str, np.ndarray]:
        """Constants of the integrator's own rows before the first step of dt [s], by
        row, (C, 1 to n) each.

        masses: (C, n) over mass per length [m]. segment: (C,) rest length [m]. slopes:
        finds what may be averaged.
        """
        return {}


@dataclass(frozen=True)
class SemiImplicitEuler(Integrator):
    """v' = v + dt a(x, v), x' = x + dt v'. Keeps the energy of undamped strings
    bounded.
    """

    name: str = "semi_implicit_euler"
    stage_times: tuple[float, ...] = (0.0,)
    order: int = 1
    update_source: tuple[str, ...] = (
        "qx += dt * ax",
        "qy += dt * ay",
        "px += dt * qx",
        "py += dt * qy",
    )
    velocity_lag: float = 0.5

    def largest_stable_step(
        self, frequency2: np.ndarray, damping: np.ndarray, drag: np.ndarray
    ) -> np.ndarray:
        """The largest stable step [s] by Jury's criterion for x'' = -w^2 x - c x': w^2
        dt^2 + 2 c dt < 4.
        """
        c = damping.sum(axis=0) + drag
        return 4.0 / (c + np.sqrt(c**2 + 4.0 * frequency2.sum(axis=0)))


@dataclass(frozen=True)
class RungeKutta4(Integrator):
    """The classical fourth-order method, for reference solutions and the virtual lab."""

    name: str = "runge_kutta_4"
    stage_times: tuple[float, ...] = (0.0, 0.5, 0.5, 1.0)
    order: int = 4
    row_names: tuple[str, ...] = ("R0", "R1", "R2", "R3", "R4", "R5", "R6", "R7")
    update_source: tuple[str, ...] = (
        "first = stage == 0",
        "last = stage == 3",
        "bx = px if first else B[R0 + p]",
        "by = py if first else B[R1 + p]",
        "ux = qx if first else B[R2 + p]",
        "uy = qy if first else B[R3 + p]",
        "weight = 1.0 if first or last else 2.0",
        "sx = qx if first else B[R4 + p] + weight * qx",
        "sy = qy if first else B[R5 + p] + weight * qy",
        "gx = ax if first else B[R6 + p] + weight * ax",
        "gy = ay if first else B[R7 + p] + weight * ay",
        "B[R0 + p] = bx",
        "B[R1 + p] = by",
        "B[R2 + p] = ux",
        "B[R3 + p] = uy",
        "B[R4 + p] = sx",
        "B[R5 + p] = sy",
        "B[R6 + p] = gx",
        "B[R7 + p] = gy",
        "h = dt / 6.0 if last else (dt if stage == 2 else 0.5 * dt)",
        "px = bx + h * (sx if last else qx)",
        "py = by + h * (sy if last else qy)",
        "qx = ux + h * (gx if last else ax)",
        "qy = uy + h * (gy if last else ay)",
    )

    def largest_stable_step(
        self, frequency2: np.ndarray, damping: np.ndarray, drag: np.ndarray
    ) -> np.ndarray:
        """Real axis to 2.78, imaginary axis to 2.82; the bound of both together, kept
        simple.
        """
        return 2.6 / (damping.sum(axis=0) + drag + np.sqrt(frequency2.sum(axis=0)))
