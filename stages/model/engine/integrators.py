"""Time steps of the string engine: each is the few lines that move one mass point.

A step is one or more passes over the string. `update_source` is text that the step loop
holds where the acceleration (ax, ay) of a point is known; it sees its position px, py,
its velocity qx, qy, the step dt, and rows of its own. A method that moves the points
together only keeps the acceleration, and moves them after the pass (`solve_source`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from stringcast.stages.model.engine import rotation

# Stiffness and damping: axial, in bending and at the grasp, (3, C).
Slopes = Callable[[], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Integrator:
    """A time step of the string engine.

    Parameters
    ----------
    name : str
        Name of the method.
    stage_times : tuple of float
        When in a step the forces are evaluated, in steps, one for each pass.
    order : int
        Order of convergence.
    update_source : str
        Text that moves a point.
    velocity_lag : float
        How far the velocities that it keeps are behind the positions, in steps.
    row_names : tuple of str
        Names of its own rows.
    velocity_source : str
        Text of the velocity qx, qy that loads see.
    averaged_slots : tuple of str
        Slots that bound no step, since the step averages them as they are.
    turn_source : str
        Text of how a segment's turn in a step is measured.
    solve_source : str
        Template of the text that runs after each pass.
    """

    name: str
    stage_times: tuple[float, ...]
    order: int
    update_source: str
    velocity_lag: float = 0.0
    row_names: tuple[str, ...] = ()
    velocity_source: str = "qx = rows[VX + point]\nqy = rows[VY + point]"
    averaged_slots: tuple[str, ...] = ()
    turn_source: str = field(default=rotation.SMALL_TURN_SOURCE, repr=False)
    solve_source: str = field(default="", repr=False)

    def largest_stable_step(
        self, frequency2: np.ndarray, damping: np.ndarray, drag: np.ndarray
    ) -> np.ndarray:
        """Find the largest stable step.

        Parameters
        ----------
        frequency2, damping : ndarray of shape (M, C)
            Bounds [1/s^2], [1/s] for M kinds of motion, whose sums bound all together.
        drag : ndarray of shape (C,)
            The most that air adds [1/s].

        Returns
        -------
        ndarray of shape (C,)
            Step [s].
        """
        raise NotImplementedError

    def step_limiting_slope(
        self, steepest: np.ndarray, gentlest: np.ndarray
    ) -> np.ndarray:
        """Return the part of a law's slope that limits the step: all of it.

        steepest, gentlest: (C,) over the string's range.
        """
        return steepest

    def row_values(
        self, masses: np.ndarray, segment: np.ndarray, slopes: Slopes, dt: float
    ) -> Mapping[str, np.ndarray]:
        """Return constants of the integrator's own rows, by row, (C, 1 to n) each.

        Parameters
        ----------
        masses : ndarray of shape (C, n)
            Masses over mass per length [m].
        segment : ndarray of shape (C,)
            Rest length of a segment [m].
        slopes : callable
            Finds what may be averaged.
        dt : float
            Step [s].
        """
        return {}


@dataclass(frozen=True)
class SemiImplicitEuler(Integrator):
    """v' = v + dt a(x, v), x' = x + dt v'. Keeps undamped energy bounded."""

    name: str = "semi_implicit_euler"
    stage_times: tuple[float, ...] = (0.0,)
    order: int = 1
    update_source: str = "qx += dt * ax\nqy += dt * ay\npx += dt * qx\npy += dt * qy"
    velocity_lag: float = 0.5

    def largest_stable_step(
        self, frequency2: np.ndarray, damping: np.ndarray, drag: np.ndarray
    ) -> np.ndarray:
        """Find the largest stable step [s], (C,).

        By Jury's criterion for x'' = -w^2 x - c x': w^2 dt^2 + 2 c dt < 4.
        """
        c = damping.sum(axis=0) + drag
        largest_step: np.ndarray = 4.0 / (
            c + np.sqrt(c**2 + 4.0 * frequency2.sum(axis=0))
        )
        return largest_step


# Rows: position and velocity at the step's start, and weighted sums of the stages.
RUNGE_KUTTA_ROWS = (
    "START_X",
    "START_Y",
    "START_VX",
    "START_VY",
    "SUM_VX",
    "SUM_VY",
    "SUM_AX",
    "SUM_AY",
)
RUNGE_KUTTA_UPDATE = """\
first = stage == 0
last = stage == 3
bx = px if first else rows[START_X + point]
by = py if first else rows[START_Y + point]
ux = qx if first else rows[START_VX + point]
uy = qy if first else rows[START_VY + point]
weight = 1.0 if first or last else 2.0
sx = qx if first else rows[SUM_VX + point] + weight * qx
sy = qy if first else rows[SUM_VY + point] + weight * qy
gx = ax if first else rows[SUM_AX + point] + weight * ax
gy = ay if first else rows[SUM_AY + point] + weight * ay
rows[START_X + point] = bx
rows[START_Y + point] = by
rows[START_VX + point] = ux
rows[START_VY + point] = uy
rows[SUM_VX + point] = sx
rows[SUM_VY + point] = sy
rows[SUM_AX + point] = gx
rows[SUM_AY + point] = gy
h = dt / 6.0 if last else (dt if stage == 2 else 0.5 * dt)
px = bx + h * (sx if last else qx)
py = by + h * (sy if last else qy)
qx = ux + h * (gx if last else ax)
qy = uy + h * (gy if last else ay)"""


@dataclass(frozen=True)
class RungeKutta4(Integrator):
    """The classical fourth-order method, for reference solutions."""

    name: str = "runge_kutta_4"
    stage_times: tuple[float, ...] = (0.0, 0.5, 0.5, 1.0)
    order: int = 4
    row_names: tuple[str, ...] = RUNGE_KUTTA_ROWS
    update_source: str = RUNGE_KUTTA_UPDATE

    def largest_stable_step(
        self, frequency2: np.ndarray, damping: np.ndarray, drag: np.ndarray
    ) -> np.ndarray:
        """Find the largest stable step [s], (C,).

        Real axis to 2.78, imaginary axis to 2.82; the bound of both together, kept
        simple.
        """
        c = damping.sum(axis=0) + drag
        largest_step: np.ndarray = 2.6 / (c + np.sqrt(frequency2.sum(axis=0)))
        return largest_step
