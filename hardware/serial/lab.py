"""A real arm over a serial port, watched by a camera."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, PositiveInt

from stringcast.hardware.arm import Driving, VelocityArm
from stringcast.hardware.camera import FilmingCamera, Source
from stringcast.hardware.serial.wire import SerialWire
from stringcast.stages.execute.interfaces import Lab
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.camera import Camera


def open_lab(
    arm: Arm,
    camera: Camera,
    *,
    seed: int,
    trial: int,
    port: str,
    baud: PositiveInt,
    driving: Driving,
    source: Source,
    most_lost: Annotated[float, Field(ge=0, le=1)],
) -> Lab:
    """Open the arm on `port` and the camera `source`.

    Parameters
    ----------
    arm, camera
        The required arm and camera.
    seed, trial
        Unused: nothing is random here.
    port, baud
        The serial port; see `SerialWire`.
    driving
        Settings of the driver; see `Driving`.
    source, most_lost
        The camera; see `FilmingCamera`.

    Returns
    -------
    Lab
        Arm and camera, not yet connected.
    """
    return Lab(
        VelocityArm(arm, SerialWire(port, baud), driving),
        FilmingCamera(camera, source, most_lost),
    )
