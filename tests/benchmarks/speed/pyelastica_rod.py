"""The cord in PyElastica: several Cosserat rods in one simulator, for speed.

The first element is centred on the clamp, so that the rod is clamped where the cord is,
and not half an element further. PyElastica has no bending damping; a couple of our own
adds it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import elastica
import numpy as np

from tests.benchmarks.speed.cord import CORD, GRAVITY, TIMES, hand_pose, hanging_depth

# normal of the plane of motion, the first director of every element
NORMAL = np.array([0.0, 0.0, 1.0])


class Simulator(
    elastica.BaseSystemCollection,
    elastica.Constraints,
    elastica.Forcing,
):
    """The features of PyElastica that the cord needs."""


class Hand(elastica.ConstraintBase):
    """A constraint of the middle of the first element to the pose of each step."""

    def __init__(
        self,
        poses: np.ndarray,
        rates: np.ndarray,
        step: float,
        half: float,
        **options: Any,
    ) -> None:
        """Take poses and rates (2 steps + 1, 3) at half steps, and half an element.

        The half element is in metres.
        """
        super().__init__(**options)
        self.poses, self.rates, self.every, self.half = poses, rates, step / 2, half

    def constrain_values(self, system: Any, time: float) -> None:
        """Constrain the first node and the first element's directors."""
        x, y, theta = self.poses[min(round(time / self.every), len(self.poses) - 1)]
        c, s = np.cos(theta), np.sin(theta)
        system.position_collection[:, 0] = (x - self.half * c, y - self.half * s, 0.0)
        system.director_collection[:, :, 0] = (
            (0.0, 0.0, 1.0),
            (s, -c, 0.0),
            (c, s, 0.0),
        )

    def constrain_rates(self, system: Any, time: float) -> None:
        """Constrain the velocities of the first node and element."""
        x, y, theta = self.rates[min(round(time / self.every), len(self.rates) - 1)]
        now = self.poses[min(round(time / self.every), len(self.poses) - 1), 2]
        c, s = np.cos(now), np.sin(now)
        system.velocity_collection[:, 0] = (
            x + self.half * s * theta,
            y - self.half * c * theta,
            0.0,
        )
        system.omega_collection[:, 0] = (theta, 0.0, 0.0)


class BendingDamping(elastica.NoForces):
    """A couple proportional to the rate of curvature, about the normal of the plane."""

    def __init__(self, damping: float) -> None:
        """Set the damping [N m^2 s]."""
        super().__init__()
        self.damping = damping

    def apply_torques(self, system: Any, time: float = 0.0) -> None:
        """Add the couple to both elements that meet at a node."""
        couple = (
            self.damping
            * np.diff(system.omega_collection[0])
            / system.rest_voronoi_lengths
        )
        system.external_torques[0, :-1] += couple
        system.external_torques[0, 1:] -= couple


@dataclass(frozen=True)
class Rods:
    """Rods of so many elements, half an element longer than from grasp to tip.

    The step [s] divides a camera frame.
    """

    elements: int
    step: float

    def prepare_rollout(
        self, count: int, duration: float = float(TIMES[-1])
    ) -> Callable[[], np.ndarray]:
        """Assemble `count` rods; return a function that simulates them together, once.

        It returns their tips at TIMES up to `duration` [s], (count, F, 2) [m].
        """
        simulator, rods = self._assemble(count)
        stepper = elastica.PositionVerlet()
        every = round((TIMES[1] - TIMES[0]) / self.step)
        frames = round(duration / TIMES[1])

        def run() -> np.ndarray:
            tips = np.empty((count, frames + 1, 2))
            time = np.float64(0.0)
            for frame in range(frames + 1):
                tips[:, frame] = [rod.position_collection[:2, -1] for rod in rods]
                if frame < frames:
                    for _ in range(every):
                        time = stepper.step(simulator, time, self.step)
            return tips

        return run

    def _assemble(self, count: int) -> tuple[Simulator, list[Any]]:
        """Assemble a simulator with its rods at rest in the hand."""
        simulator = Simulator()
        length = CORD.length / (self.elements - 0.5)
        halves = hand_pose(
            np.arange(2 * round(TIMES[-1] / self.step) + 1) * self.step / 2
        )
        rates = np.gradient(halves, self.step / 2, axis=0)
        rods = [self._rod(length) for _ in range(count)]
        for rod in rods:
            simulator.append(rod)
            simulator.constrain(rod).using(Hand, halves, rates, self.step, length / 2)
            simulator.add_forcing_to(rod).using(
                elastica.GravityForces, acc_gravity=np.array([0.0, -GRAVITY, 0.0])
            )
            simulator.add_forcing_to(rod).using(
                BendingDamping, CORD.bending_damping * CORD.mass
            )
        simulator.finalize()
        return simulator, rods

    def _rod(self, length: float) -> Any:
        """Make a rod that hangs straight down, stretched by its weight."""
        area = np.pi * CORD.radius**2
        modulus = CORD.axial * CORD.mass / area
        s = (np.arange(self.elements + 1) - 0.5) * length
        x, y, _ = hand_pose(0.0)
        rod = elastica.CosseratRod.straight_rod(
            self.elements,
            np.array([x, y - s[0], 0.0]),
            np.array([0.0, -1.0, 0.0]),
            NORMAL.copy(),
            base_length=length * self.elements,
            base_radius=CORD.radius,
            density=CORD.mass / area,
            youngs_modulus=modulus,
            shear_modulus=modulus / 3,
        )
        rod.position_collection[1, 1:] = y - hanging_depth(s[1:])
        return rod
