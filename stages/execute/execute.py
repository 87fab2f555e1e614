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


def run(call: StageCall, motion: Motion) -> Trial:
    """The stage: the trial that the lab's arm and camera record of a motion."""
    lab = call.setup.lab(call.number)
    made: Trial = call.by(motion, lab.arm, lab.camera)
    return made


def execute(
    motion: Motion,
    arm: ArmDevice,
    camera: CameraDevice,
    *,
    before: Annotated[float, Field(ge=0, le=10)],
    after: Annotated[float, Field(ge=0, le=10)],
) -> Trial:
    """Perform `motion` and record the trial: commands, measured angles, frames.

    before, after: rest filmed around the movement [s] (V: 0.2 s). Devices are opened
    here and always left stopped. Raises what the devices raise.
    """
    commands = pad_commands(motion.commands, before, after)
    with camera, arm:
        return film_motion(commands, arm, camera, end=motion.duration + after)


def film_motion(
    commands: pd.DataFrame, arm: ArmDevice, camera: CameraDevice, end: float
) -> Trial:
    """Go to the start of `commands` and play them on film, with open devices. end: of
    the film [s]. Raises HardwareError where no frame came meanwhile.
    """
    begin = float(commands["t"].iloc[0])
    arm.move_to(commands[list(JOINTS)].iloc[0].tolist())
    camera.start()
    performance = arm.perform(commands)
    recording = camera.stop(performance.started_at - begin)

    # frames at the very ends count, whatever the rounding
    inside = np.flatnonzero((recording.t >= begin - 1e-9) & (recording.t <= end + 1e-9))
    if not len(inside):
        why = recording.fault or "its clock or delay is wrong"
        raise HardwareError(
            f"camera: no frame came during the movement ({why}). Check the device and source.delay."
        )
    files = [f"images/{number:06d}.png" for number in range(len(inside))]
    frames = pd.DataFrame(
        {"frame": np.arange(len(inside)), "t": recording.t[inside], "file": files}
    )
    frames = frames.assign(
        **{name: column.to_numpy()[inside] for name, column in recording.counts.items()}
    )
    images = [recording.images[int(i)] for i in inside]
    link = performance.link.assign(**recording.summary)
    trial = Trial(performance.arm, performance.ticks, frames, link, images)
    return mark_distrusted(trial, recording.fault) if recording.fault else trial


def mark_distrusted(trial: Trial, reason: str) -> Trial:
    """The trial marked, so that no later stage learns from it."""
    reasons = "; ".join(filter(None, (reason, str(trial.link["reason"].iloc[0]))))
    return replace(trial, link=trial.link.assign(valid=False, reason=reasons))


def pad_commands(commands: pd.DataFrame, before: float, after: float) -> pd.DataFrame:
    """Commands with rest before and after, on the same tick; the movement still starts
    at t = 0.
    """
    tick = float(np.median(np.diff(commands["t"])))
    early, late = (round(rest / tick) for rest in (before, after))
    still = dict.fromkeys(SPEEDS, 0.0)
    first = (
        pd.concat([commands.iloc[:1]] * early, ignore_index=True).assign(**still)
        if early
        else commands.iloc[:0]
    )
    last = (
        pd.concat([commands.iloc[-1:]] * late, ignore_index=True).assign(**still)
        if late
        else commands.iloc[:0]
    )
    whole = pd.concat([first, commands, last], ignore_index=True)
    return whole.assign(
        t=commands["t"].iloc[0] + tick * (np.arange(len(whole)) - early)
    )
