"""The strings that are simulated, the motion of the hand, and where a perfect
simulation has the tip.

`string_b` is string B of the virtual lab as the paper models it, Eq. 1 with n points
alike. The cord is string B clamped in the hand and without air, so that a chain of mass
points, a chain of hinges and a Cosserat rod can be the same cord: of the same mass,
bending stiffness and bending damping. They converge to the same motion but for what
they leave out or add: hinges do not stretch, rods shear. So each is judged by the limit
that it itself converges to.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from stringcast.stages.model.engine.implicit_leapfrog import ImplicitLeapfrog
from stringcast.stages.model.engine.simulate import simulate
from stringcast.stages.model.hand import HandMotion, resample_hand_motion
from stringcast.stages.model.string import String

ROOT = Path(__file__).resolve().parents[2]
TIMES = np.arange(301) * 0.005  # [s]: a trial of 1.5 s, a frame every 5 ms
PIXEL = 3e-3  # [m], one pixel of the camera in conf/camera: no tip is seen better
B = yaml.safe_load((ROOT / "conf/specimen/B.yaml").read_text())["parameters"]
PER_POINT = (0.300 / 9) ** 2  # from values per mass point at n = 10 to the material's


@dataclass(frozen=True)
class Cord:
    """length [m]; mass [kg/m]; over mass per length: axial EA [m^2/s^2], bending EI
    [m^4/s^2], its damping [m^4/s].
    """

    length: float = 0.300
    mass: float = 0.010
    axial: float = B["axial_stiffness"] * PER_POINT
    bending: float = B["bending_stiffness"] * PER_POINT
    bending_damping: float = B["bending_damping"] * PER_POINT

    @property
    def radius(self) -> float:
        """Of a round cord of these EA and EI [m]."""
        return 2 * float(np.sqrt(self.bending / self.axial))


CORD = Cord()


def pose(t: np.ndarray) -> np.ndarray:
    """Pose of the grasp (x [m], y [m], theta [rad]) at times t [s], (..., 3): back,
    then out and up, within 1.1 s.

    It begins straight down, so that the cord hangs straight at first.
    """
    u = np.clip((np.asarray(t) - 0.2) / 1.1, 0.0, 1.0)
    out = u**3 * (10 - 15 * u + 6 * u**2)
    back = np.sin(2 * np.pi * u) * np.sin(np.pi * u) ** 2
    return np.stack(
        [0.30 * out - 0.05 * back, 0.20 * out, -np.pi / 2 + 1.0 * out - 0.4 * back],
        axis=-1,
    )


def stretched(s: np.ndarray) -> np.ndarray:
    """How far below the hand a point at arc length s [m] hangs at first [m]: s + g / EA
    (L s - s^2 / 2).
    """
    return s + 9.81 / CORD.axial * (CORD.length * s - s**2 / 2)


def hand() -> HandMotion:
    """The hand's motion on the engine's ticks."""
    return resample_hand_motion(TIMES, pose(TIMES))


def string_b(points: int) -> tuple[String, np.ndarray]:
    """The string of Eq. 1 and string B's parameters (P,)."""
    string = String(CORD.length, points=points)
    return string, string.values(B)


def cord_string(points: int, largest_step: float) -> tuple[String, np.ndarray]:
    """A string that converges to the cord to second order in points and step, and its
    parameters (P,).
    """
    accurate = {
        "tip_cell": 0.5,
        "grasp_cell": 0.5,
        "integrator": ImplicitLeapfrog(),
        "largest_step": largest_step,
    }
    string = String(CORD.length, points=points, **accurate)
    without = {"axial_damping": 0.0, "linear_drag": 0.0, "quadratic_drag": 0.0}
    clamped = {"grasp_stiffness": 1e9, "grasp_damping": 1e6}
    return string, string.values(B | without | clamped)


def engine_tip(points: int, largest_step: float) -> np.ndarray:
    """(F, 2) the cord's tip [m] at TIMES, by the engine."""
    string, values = cord_string(points, largest_step)
    return simulate(string, hand(), values[None], TIMES).tip[0]


def tip_error(tip: np.ndarray, exact: np.ndarray) -> float:
    """The farthest that a tip (F, 2) is ever from where it should be [m]."""
    return float(np.linalg.norm(tip - exact, axis=-1).max())
