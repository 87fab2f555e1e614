"""A wire-driven arm: each joint hangs by an elastic wire on a motor whose velocity loop follows the firmware."""

from __future__ import annotations

import math
from dataclasses import dataclass

STEP = 0.0005  # [s]
LAG = 0.004  # [s] time constant of the motor's velocity loop
FREQUENCY = 30.0  # [Hz] of the joint on its wire, motor held
DAMPING = 0.7  # share of critical
STILL = 0.01  # [rad/s] below which a joint counts as standing


@dataclass
class Joint:
    """motor, angle [rad]; drive, speed: their velocities [rad/s]. offset: error of the encoder [rad]."""

    motor: float = 0.0
    drive: float = 0.0
    angle: float = 0.0
    speed: float = 0.0
    offset: float = 0.0

    def step(self, target: float) -> None:
        """Let one step pass, by semi-implicit Euler. target: velocity commanded [rad/s]."""
        self.drive += (target - self.drive) * STEP / LAG
        self.motor += self.drive * STEP
        turn = 2 * math.pi * FREQUENCY
        pull = turn**2 * (self.motor - self.angle) + 2 * DAMPING * turn * (self.drive - self.speed)
        self.speed += pull * STEP
        self.angle += self.speed * STEP

    @property
    def encoder(self) -> float:
        """The encoder's reading [rad]."""
        return self.angle + self.offset

    @property
    def still(self) -> bool:
        """Whether it stands, its wire at rest."""
        return abs(self.speed) < STILL and abs(self.drive) < STILL
