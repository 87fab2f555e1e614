"""A real arm over a serial port, watched by a camera that OpenCV can open."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from hardware.opencv_camera import OpenCvCamera
from hardware.serial.arm import SerialArm
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
    misses: Annotated[int, Field(ge=1)],
    late: Annotated[float, Field(gt=0)],
    most_missed: Annotated[float, Field(ge=0, le=1)],
    approach: Annotated[float, Field(gt=0)],
    settle: Annotated[float, Field(ge=0)],
    source: int | str,
    delay: float,
) -> Lab:
    """The arm on `port` and the camera `source`; see `SerialArm` and `OpenCvCamera`. Nothing is left to chance
    here: seed and trial play no part."""
    driver = SerialArm(arm, port, baud, misses, late, most_missed, approach, settle)
    return Lab(driver, OpenCvCamera(camera, source, delay))
