"""Dry runs of a cast with the arm disabled or slow; their trials are marked invalid."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np
import pandas as pd
from pydantic import Field

from stringcast.data.artifacts import JOINTS, SPEEDS, Motion, Trial
from stringcast.stages.execute.execute import (
    RestSeconds,
    execute,
    film_motion,
    mark_invalid,
    pad_commands,
)
from stringcast.stages.execute.interfaces import ArmDevice, CameraDevice


def dry_run(
    motion: Motion,
    arm: ArmDevice,
    camera: CameraDevice,
    *,
    before: RestSeconds,
    after: RestSeconds,
) -> Trial:
    """Make a dry run with the arm disabled.

    Tests the link, checks the motion, sends zero velocities at its ticks, and films the
    arm.

    Parameters
    ----------
    motion : Motion
        Commands of the movement.
    arm : ArmDevice
        The arm that is tested.
    camera : CameraDevice
        The camera that films it.
    before, after : float
        Rest filmed before and after the movement [s].

    Returns
    -------
    Trial
        The trial, marked invalid.

    Raises
    ------
    HardwareError
        If a device fails, or the motion leaves a limit of the arm.
    """
    commands = pad_commands(motion.commands, before, after)
    with camera, arm:
        arm.check(commands)
        still = commands.copy()
        still[list(JOINTS)] = arm.angles()
        still[list(SPEEDS)] = 0.0
        trial = film_motion(still, arm, camera, end=motion.duration + after)
    return mark_invalid(trial, "dry run with the arm disabled")


def slow_run(
    motion: Motion,
    arm: ArmDevice,
    camera: CameraDevice,
    *,
    before: RestSeconds,
    after: RestSeconds,
    share: Annotated[float, Field(gt=0, lt=1)],
) -> Trial:
    """Make a slow run along the same path.

    Parameters
    ----------
    motion : Motion
        Commands of the movement.
    arm : ArmDevice
        The arm that performs it.
    camera : CameraDevice
        The camera that films it.
    before, after : float
        Rest filmed before and after the movement [s].
    share : float
        Speed as a share of the planned one.

    Returns
    -------
    Trial
        The trial, marked invalid.

    Raises
    ------
    HardwareError
        If a device fails.
    """
    slower = replace(
        motion,
        commands=slow_commands(motion.commands, share),
        outcome=motion.outcome.assign(duration=motion.duration / share),
    )
    trial = execute(slower, arm, camera, before=before, after=after)
    return mark_invalid(trial, f"dry run at {share:g} of the speed")


def slow_commands(commands: pd.DataFrame, share: float) -> pd.DataFrame:
    """Slow commands (table COMMANDS) down to a share of their speed, at the same tick.

    Accelerations fall by `share` at least.
    """
    t = commands["t"].to_numpy()
    tick = float(np.median(np.diff(t)))
    count = int(np.ceil((len(t) - 1) / share)) + 1
    place = np.minimum(np.arange(count) * share, len(t) - 1)
    slow = pd.DataFrame({"t": t[0] + tick * np.arange(count)})
    for joint, speed in zip(JOINTS, SPEEDS, strict=True):
        angle = np.interp(place, np.arange(len(t)), commands[joint])
        slow[joint] = angle
        slow[speed] = np.append(np.diff(angle) / tick, 0.0)
    return slow[["t", *JOINTS, *SPEEDS]]
