"""Films of the study: a random cast of a string, filmed under a condition and read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd

from stringcast.data.artifacts import JOINTS, Film, Points
from stringcast.hardware.virtual import Specimen, VirtualBench
from stringcast.stages.extract.footage import Footage, footage_from_joints
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.camera import Camera
from tests.benchmarks.extraction.casts import draw_cast
from tests.benchmarks.extraction.conditions import (
    Condition,
    Shot,
    film_shot,
    prepare_shot,
)

Extract = Callable[[Footage, Camera], Points]


@dataclass(frozen=True)
class StagedCast:
    """One cast of one string, ready to be filmed.

    `reported_angles` is what the arm reports, table ARM.
    """

    string: str
    seed: int
    shot: Shot
    reported_angles: pd.DataFrame
    arm: Arm


@dataclass(frozen=True)
class ConditionLevel:
    """A condition at one of its severities, counted from 1."""

    condition: str
    severity: int
    parts: tuple[Condition, ...]


def perform_cast(
    string: str, specimen: Specimen, arm: Arm, camera: Camera, frames: int, seed: int
) -> StagedCast:
    """Perform a random cast and choose `frames` moments of it, spread evenly."""
    cast = draw_cast(arm, np.random.default_rng([seed, 7]), camera.fps)
    motion = cast.motion
    times = motion.start + motion.tick * np.arange(motion.angles.shape[1])
    bench = VirtualBench(
        arm, camera, specimen, seed, performed_motion=(times, motion.angles[0])
    )
    chosen = np.unique(np.linspace(0, len(cast.frames) - 1, frames).astype(int))
    angles = dict(zip(JOINTS, cast.reported.T, strict=True))
    reported = pd.DataFrame({"t": cast.t} | angles)
    return StagedCast(
        string, seed, prepare_shot(bench, cast.frames[chosen]), reported, arm
    )


def film_cast(cast: StagedCast, level: ConditionLevel) -> tuple[Footage, Shot]:
    """Film a cast under a condition; return the footage and the true string."""
    shot = cast.shot
    for condition in level.parts:
        shot = condition.change_scene(shot)
    images = film_shot(shot, level.parts, cast.seed)
    return footage_from_joints(
        Film(shot.frame_times, images, arm=cast.reported_angles), cast.arm
    ), shot


def read_cast(
    cast: StagedCast, level: ConditionLevel, extract: Extract
) -> tuple[Points, Shot]:
    """Film a cast under a condition and extract its points.

    Returns the points and the true string.
    """
    footage, shot = film_cast(cast, level)
    return extract(footage, shot.camera), shot
