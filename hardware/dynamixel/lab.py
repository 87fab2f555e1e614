"""An arm of Dynamixel servos, watched by a camera."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, PositiveFloat, PositiveInt

from stringcast.hardware.arm import Driving, VelocityArm
from stringcast.hardware.camera import FilmingCamera, Source
from stringcast.hardware.dynamixel.bus import DynamixelBus, ServoSettings
from stringcast.stages.execute.interfaces import HardwareError, Lab
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
    servos: tuple[ServoSettings, ...],
    reply: PositiveFloat,
    patience: Annotated[int, Field(ge=1, le=127)],
    driving: Driving,
    source: Source,
    most_lost: Annotated[float, Field(ge=0, le=1)],
) -> Lab:
    """Open the servos on `port` and the camera `source`.

    Parameters
    ----------
    arm, camera
        The required arm and camera.
    seed, trial
        Unused: nothing is random here.
    port, baud, servos, reply, patience
        The bus; see `DynamixelBus`.
    driving
        Settings of the driver; see `Driving`.
    source, most_lost
        The camera; see `FilmingCamera`.

    Returns
    -------
    Lab
        Arm and camera, not yet connected.

    Raises
    ------
    HardwareError
        If servos and links differ in number.
    """
    if len(servos) != len(arm.links):
        raise HardwareError(
            "",
            f"hardware.servos names {len(servos)} servos, arm.links has "
            f"{len(arm.links)}",
            "Match them.",
        )
    bus = DynamixelBus(port, baud, servos, arm.speed, reply, patience)
    return Lab(VelocityArm(arm, bus, driving), FilmingCamera(camera, source, most_lost))
