"""The cord that the engine and its peers simulate, and the motion of the hand.

The cord is string B of the virtual lab, clamped in the hand and without air. A chain of
mass points, a chain of hinges and a Cosserat rod can then be the same cord: the same
mass, bending stiffness and bending damping. They converge to nearly the same motion;
hinges do not stretch and rods shear. So each is judged by the limit that it converges
to.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from stringcast.stages.model.engine.implicit_leapfrog import ImplicitLeapfrog
from stringcast.stages.model.hand import HandMotion, resample_hand_motion
from stringcast.stages.model.string import String

ROOT = Path(__file__).resolve().parents[3]
TIMES = np.arange(301) * 0.005  # [s]: a trial of 1.5 s, a frame every 5 ms
B = yaml.safe_load((ROOT / "conf/specimen/B.yaml").read_text())["parameters"]
PER_POINT = (0.300 / 9) ** 2  # from values per mass point at n = 10 to the material's
GRAVITY = 9.81


@dataclass(frozen=True)
class Cord:
    """A round cord.

    Attributes
    ----------
    length
        [m].
    mass
        Per length [kg/m].
    axial, bending, bending_damping
        EA [m^2/s^2], EI [m^4/s^2] and bending damping [m^4/s], all per mass and length.
    """

    length: float = 0.300
    mass: float = 0.010
    axial: float = B["axial_stiffness"] * PER_POINT
    bending: float = B["bending_stiffness"] * PER_POINT
    bending_damping: float = B["bending_damping"] * PER_POINT

    @property
    def radius(self) -> float:
        """Return the radius of a round cord of this EA and EI [m]."""
        return 2 * float(np.sqrt(self.bending / self.axial))


CORD = Cord()


def hand_pose(t: np.ndarray) -> np.ndarray:
    """Return the pose of the hand (x [m], y [m], theta [rad]) at times t [s], (..., 3).

    The hand starts straight down, moves back, then out and up within 1.1 s.
    """
    u = np.clip((np.asarray(t) - 0.2) / 1.1, 0.0, 1.0)
    out = u**3 * (10 - 15 * u + 6 * u**2)
    back = np.sin(2 * np.pi * u) * np.sin(np.pi * u) ** 2
    x = 0.30 * out - 0.05 * back
    theta = -np.pi / 2 + 1.0 * out - 0.4 * back
    return np.stack([x, 0.20 * out, theta], axis=-1)


def hanging_depth(s: np.ndarray) -> np.ndarray:
    """Return the depth below the hand of points at arc length s [m] at rest."""
    return s + GRAVITY / CORD.axial * (CORD.length * s - s**2 / 2)


def hand_motion() -> HandMotion:
    """Return the motion of the hand on the engine's ticks."""
    return resample_hand_motion(TIMES, hand_pose(TIMES))


def cord_string(points: int, largest_step: float) -> tuple[String, np.ndarray]:
    """Return a string that converges to the cord to second order.

    Its parameters (P,) are returned, too.
    """
    string = String(
        CORD.length,
        points=points,
        tip_cell=0.5,
        grasp_cell=0.5,
        integrator=ImplicitLeapfrog(),
        largest_step=largest_step,
    )
    no_air = {"axial_damping": 0.0, "linear_drag": 0.0, "quadratic_drag": 0.0}
    clamped = {"grasp_stiffness": 1e9, "grasp_damping": 1e6}
    return string, string.values(B | no_air | clamped)
