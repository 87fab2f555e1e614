"""An arm that takes joint velocities every tick, whatever carries them: checks,
schedule, stop and record.
"""

from stringcast.hardware.arm.device import Driving, VelocityArm
from stringcast.hardware.arm.wire import ArmAnswer, Wire

__all__ = ["ArmAnswer", "Driving", "VelocityArm", "Wire"]
