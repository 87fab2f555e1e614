"""Time steps of the string engine: each is a few lines that move one mass point.

A step is one or more passes over the string. The step loop contains the text
`update_source` where it has the acceleration (ax, ay) of a point. The text uses the
position px, py, the velocity qx, qy, the step dt, and rows of the integrator. A method
that moves all points together only stores the acceleration, and moves the points after
the pass (`solve_source`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from stringcast.stages.model.engine import rotation

# Stiffness and damping, (3, C) each: axial, in bending and at the grasp.
Slopes = Callable[[], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Integrator:
    """A time step of the string engine.

    Parameters
    ----------
    name : str
        Name of the method.
    stage_times : tuple of float
        Times at which the passes evaluate forces, as fractions of a step.
    order : int
        Order of convergence.
    update_source : str
        Text that moves a point.
    velocity_lag : float
        Lag of the stored velocities behind the positions, in steps.
    row_names : tuple of str
        Names of the integrator's rows.
    velocity_source : str
        Text that computes the velocity qx, qy for loads.
    averaged_slots : tuple of str
        Slots that do not bound the step, because it averages them completely.
    turn_source : str
        Text that measures a segment's turn in a step.
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
            Bounds [1/s^2], [1/s] for M kinds of motion; their sums bound the whole.
        drag : ndarray of shape (C,)
            Largest damping rate of drag [1/s].

        Returns
        -------
        ndarray of shape (C,)
            Step [s].
        """
        raise NotImplementedError

    def step_limiting_slope(
        self, steepest: np.ndarray, gentlest: np.ndarray
    ) -> np.ndarray:
        """Return the part of a law's slope that limits the step.

        steepest, gentlest: largest and smallest slope over the string's range, (C,).
        """
        return steepest

    def row_values(
        self, masses: np.ndarray, segment: np.ndarray, slopes: Slopes, dt: float
    ) -> Mapping[str, np.ndarray]:
        """Return constants of the integrator's rows, by row, (C, 1 to n) each.

        Parameters
        ----------
        masses : ndarray of shape (C, n)
            Masses over mass per length [m].
        segment : ndarray of shape (C,)
            Rest length of a segment [m].
        slopes : callable
            Returns the slopes that may be averaged.
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

        Jury's criterion for x'' = -w^2 x - c x' is w^2 dt^2 + 2 c dt < 4.
        """
        c = damping.sum(axis=0) + drag
        return 4.0 / (c + np.sqrt(c**2 + 4.0 * frequency2.sum(axis=0)))


# Rows: position and velocity at the start of the step, and weighted sums of stages.
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

        The limit is 2.78 on the real axis and 2.82 on the imaginary axis. The bound for
        both together is a simple one.
        """
        c = damping.sum(axis=0) + drag
        return 2.6 / (c + np.sqrt(frequency2.sum(axis=0)))
