"""Execute: perform a motion with an arm and film it with a camera."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np
import pandas as pd
from pydantic import Field

from stringcast.data.artifacts import JOINTS, SPEEDS, Motion, Trial
from stringcast.stages.execute.interfaces import ArmDevice, CameraDevice, HardwareError
from stringcast.stages.spec import StageCall

RestSeconds = Annotated[float, Field(ge=0, le=10)]
ROUNDING_S = 1e-9  # rounding error of frame times


def run(call: StageCall, motion: Motion) -> Trial:
    """Perform and film a motion in the configured lab."""
    lab = call.setup.lab(call.number)
    return call.by(motion, lab.arm, lab.camera)


def execute(
    motion: Motion,
    arm: ArmDevice,
    camera: CameraDevice,
    *,
    before: RestSeconds,
    after: RestSeconds,
) -> Trial:
    """Perform a motion and record the trial.

    Opens the devices, and always stops them.

    Parameters
    ----------
    motion : Motion
        Commands of the movement.
    arm : ArmDevice
        The arm that performs it.
    camera : CameraDevice
        The camera that films it.
    before, after : float
        Rest filmed before and after the movement [s]; 0.2 s in the paper (V).

    Returns
    -------
    Trial
        Commands, measured angles and frames.

    Raises
    ------
    HardwareError
        If a device fails.
    """
    commands = pad_commands(motion.commands, before, after)
    with camera, arm:
        return film_motion(commands, arm, camera, end=motion.duration + after)


def film_motion(
    commands: pd.DataFrame, arm: ArmDevice, camera: CameraDevice, end: float
) -> Trial:
    """Move to the start of the commands, perform and film them, with open devices.

    end: time of the last frame [s]. Raises HardwareError if there is no frame.
    """
    begin = float(commands["t"].iloc[0])
    arm.move_to(commands[list(JOINTS)].iloc[0].tolist())
    camera.start()
    performance = arm.perform(commands)
    recording = camera.stop(performance.started_at - begin)

    t = recording.t
    inside = np.flatnonzero((t >= begin - ROUNDING_S) & (t <= end + ROUNDING_S))
    if not len(inside):
        reason = recording.fault or "its clock or delay is wrong"
        raise HardwareError(
            "camera",
            f"no frame came during the movement ({reason})",
            "Check the device and source.delay.",
        )
    frames = pd.DataFrame({"frame": np.arange(len(inside)), "t": t[inside]})
    frames["file"] = [f"images/{number:06d}.png" for number in range(len(inside))]
    for name, column in recording.counts.items():
        frames[name] = column.to_numpy()[inside]
    images = [recording.images[int(i)] for i in inside]
    link = performance.link.assign(**recording.summary)
    trial = Trial(performance.arm, performance.ticks, frames, link, images)
    return mark_invalid(trial, recording.fault) if recording.fault else trial


def mark_invalid(trial: Trial, reason: str) -> Trial:
    """Mark a trial as invalid, so that no later stage uses it."""
    earlier = str(trial.link["reason"].iloc[0])
    reasons = f"{reason}; {earlier}" if earlier else reason
    return replace(trial, link=trial.link.assign(valid=False, reason=reasons))


def pad_commands(commands: pd.DataFrame, before: float, after: float) -> pd.DataFrame:
    """Add rest [s] before and after commands, with the same tick.

    The movement still starts at t = 0.
    """
    tick = float(np.median(np.diff(commands["t"])))
    early, late = round(before / tick), round(after / tick)
    rows = np.arange(-early, len(commands) + late)
    padded = commands.iloc[rows.clip(0, len(commands) - 1)].reset_index(drop=True)
    is_rest = (rows < 0) | (rows >= len(commands))
    padded.loc[is_rest, list(SPEEDS)] = 0.0
    return padded.assign(t=commands["t"].iloc[0] + tick * rows)
