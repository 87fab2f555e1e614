"""A real arm over a serial port, watched by a camera that OpenCV can open."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from hardware.arm import Driving, VelocityArm
from hardware.opencv_camera import OpenCvCamera
from hardware.serial.wire import SerialWire
from stages.model.arm import Arm
from stages.model.camera import Camera
from stages.roles import Lab


def open_lab(
    arm: Arm,
    camera: Camera,
    *,
    seed: int,
    trial: int,
    port: str,
    baud: Annotated[int, Field(gt=0)],
    driving: Driving,
    source: int | str,
    delay: float,
) -> Lab:
    """The arm on `port` and the camera `source`; see `VelocityArm` and `OpenCvCamera`. Nothing is left to chance
    here: seed and trial play no part."""
    return Lab(VelocityArm(arm, SerialWire(port, baud), driving), OpenCvCamera(camera, source, delay))
