"""The driver of an arm that takes joint velocities every tick, over any link."""

from stringcast.hardware.arm.device import Driving, VelocityArm
from stringcast.hardware.arm.wire import ArmAnswer, Wire

__all__ = ["ArmAnswer", "Driving", "VelocityArm", "Wire"]
