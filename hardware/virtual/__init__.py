"""A virtual lab: arm, string and camera, with effects that the model may lack.

No stage imports it.
"""

from __future__ import annotations

from stringcast.hardware.virtual.bench import (
    Specimen,
    VirtualArm,
    VirtualBench,
    VirtualCamera,
)
from stringcast.hardware.virtual.obstacles import Obstacles
from stringcast.hardware.virtual.render import Look
from stringcast.hardware.virtual.servo import VirtualServo
from stringcast.stages.execute.interfaces import Lab
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.camera import Camera

__all__ = [
    "Look",
    "Obstacles",
    "Specimen",
    "VirtualArm",
    "VirtualBench",
    "VirtualCamera",
    "VirtualServo",
    "open_lab",
]


def open_lab(
    arm: Arm,
    camera: Camera,
    *,
    seed: int,
    trial: int,
    specimen: Specimen,
    servo: VirtualServo,
    look: Look,
    obstacles: Obstacles,
) -> Lab:
    """Open the virtual arm and camera of one trial.

    Seed and trial number determine all random events; see `VirtualBench`.
    """
    bench = VirtualBench(arm, camera, specimen, seed, servo, look, obstacles, trial)
    return Lab(VirtualArm(bench), VirtualCamera(bench))
