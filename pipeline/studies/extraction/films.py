"""Films of the study: a random cast of a string, filmed under conditions and read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd

from stringcast.data.artifacts import JOINTS, Film, Points
from stringcast.hardware.virtual import Specimen, VirtualBench
from stringcast.hardware.virtual.conditions import (
    Condition,
    Shot,
    film_shot,
    prepare_shot,
)
from stringcast.stages.extract.footage import Footage, footage_from_joints
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.camera import Camera
from tests.benchmarks.simulators.blind.casts import random_cast

SPEEDS = (1.5, 4.0)  # of the hand [m/s]: tips reach about three times that
Extract = Callable[[Footage, Camera], Points]


@dataclass(frozen=True)
class Take:
    """One cast of one string, to be filmed. reported: what the arm reports, table ARM."""

    string: str
    seed: int
    shot: Shot
    reported: pd.DataFrame
    arm: Arm


@dataclass(frozen=True)
class Cell:
    """A condition at one of its severities, counted from 1."""

    condition: str
    severity: int
    parts: tuple[Condition, ...]


def take(
    string: str, specimen: Specimen, arm: Arm, camera: Camera, frames: int, seed: int
) -> Take:
    """A random cast, performed; `frames` of it spread evenly."""
    cast = random_cast(arm, np.random.default_rng([seed, 7]), camera.fps, SPEEDS)
    happened = cast.happened
    times = happened.start + happened.tick * np.arange(happened.angles.shape[1])
    bench = VirtualBench(
        arm, camera, specimen, seed, performed_motion=(times, happened.angles[0])
    )
    chosen = np.unique(np.linspace(0, len(cast.frames) - 1, frames).astype(int))
    reported = pd.DataFrame(
        {"t": cast.t} | dict(zip(JOINTS, cast.reported.T, strict=True))
    )
    return Take(string, seed, prepare_shot(bench, cast.frames[chosen]), reported, arm)


def filmed(one: Take, cell: Cell) -> tuple[Footage, Shot]:
    """The film of a cast under a condition, and the true string."""
    shot = one.shot
    for condition in cell.parts:
        shot = condition.change_scene(shot)
    images = film_shot(shot, cell.parts, one.seed)
    return footage_from_joints(
        Film(shot.frame_times, images, arm=one.reported), one.arm
    ), shot


def read(one: Take, cell: Cell, extract: Extract) -> tuple[Points, Shot]:
    """The points read from a cast filmed under a condition, and the true string."""
    footage, shot = filmed(one, cell)
    return extract(footage, shot.camera), shot
