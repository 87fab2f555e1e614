"""The registers of the control table for a velocity-driven arm.

References
----------
ROBOTIS e-manual, X series, protocol 2.0.
"""

from __future__ import annotations

import math
from typing import NamedTuple


class Register(NamedTuple):
    """A register by its address and its size in bytes, little-endian."""

    address: int
    size: int


DRIVE_MODE = Register(10, 1)
OPERATING_MODE = Register(11, 1)
VELOCITY_LIMIT = Register(44, 4)
TORQUE_ENABLE = Register(64, 1)
HARDWARE_ERROR = Register(70, 1)
BUS_WATCHDOG = Register(98, 1)
GOAL_VELOCITY = Register(104, 4)
PROFILE_ACCELERATION = Register(108, 4)
REALTIME_TICK = Register(120, 2)
PRESENT_POSITION = Register(132, 4)

STATE_BLOCK = Register(
    BUS_WATCHDOG.address,
    PRESENT_POSITION.address + PRESENT_POSITION.size - BUS_WATCHDOG.address,
)

VELOCITY_MODE = 1  # of OPERATING_MODE: the servo follows GOAL_VELOCITY
TIME_BASED_PROFILE = 4  # bit of DRIVE_MODE: PROFILE_ACCELERATION would be a time [ms]
# of BUS_WATCHDOG: the servo was stopped; goals are read-only until 0 is written
WATCHDOG_TRIPPED = 255
WATCHDOG_UNIT_S = 0.020  # [s]
CLOCK_WRAP_MS = 32768  # [ms] at which REALTIME_TICK wraps
VELOCITY_UNIT = 0.229 * 2 * math.pi / 60  # [rad/s]
ACCELERATION_UNIT = 214.577 * 2 * math.pi / 3600  # [rad/s^2]
POSITION_UNIT = 2 * math.pi / 4096  # [rad]


def register_value(state: bytes, register: Register) -> int:
    """Read a register from the bytes of STATE_BLOCK; four bytes are signed."""
    start = register.address - STATE_BLOCK.address
    data = state[start : start + register.size]
    return int.from_bytes(data, "little", signed=register.size == 4)
