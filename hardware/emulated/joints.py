"""The joints of a wire-driven arm.

An elastic wire connects each joint to a motor with a velocity loop.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

STEP_S = 0.0005  # [s]
MOTOR_LAG_S = 0.004  # [s] time constant of the motor's velocity loop
WIRE_FREQUENCY_HZ = 30.0  # [Hz] of the joint on its wire, with fixed motor
WIRE_DAMPING_RATIO = 0.7  # of critical damping
STANDSTILL_SPEED = 0.01  # [rad/s] below which a joint is at rest


@dataclass
class Joint:
    """A joint on its wire.

    motor, angle: angles of motor and joint [rad]. drive, speed: their velocities
    [rad/s]. offset: error of the encoder [rad].
    """

    motor: float = 0.0
    drive: float = 0.0
    angle: float = 0.0
    speed: float = 0.0
    offset: float = 0.0

    def step(self, target: float) -> None:
        """Simulate one step at a commanded velocity [rad/s] (semi-implicit Euler)."""
        self.drive += (target - self.drive) * STEP_S / MOTOR_LAG_S
        self.motor += self.drive * STEP_S
        turn = 2 * math.pi * WIRE_FREQUENCY_HZ
        elastic = turn**2 * (self.motor - self.angle)
        damping = 2 * WIRE_DAMPING_RATIO * turn * (self.drive - self.speed)
        self.speed += (elastic + damping) * STEP_S
        self.angle += self.speed * STEP_S

    @property
    def encoder(self) -> float:
        """The encoder's reading [rad]."""
        return self.angle + self.offset

    @property
    def is_still(self) -> bool:
        """Whether the joint and its wire are at rest."""
        return abs(self.speed) < STANDSTILL_SPEED and abs(self.drive) < STANDSTILL_SPEED
