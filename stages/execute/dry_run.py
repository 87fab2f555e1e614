"""Dry runs of a cast: all that `execute` does, without the arm or slowly; their trials
are marked invalid.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np
import pandas as pd
from pydantic import Field

from stringcast.data.artifacts import JOINTS, SPEEDS, Motion, Trial
from stringcast.stages.execute.execute import (
    execute,
    film_motion,
    mark_distrusted,
    pad_commands,
)
from stringcast.stages.execute.interfaces import ArmDevice, CameraDevice


def dry_run(
    motion: Motion,
    arm: ArmDevice,
    camera: CameraDevice,
    *,
    before: Annotated[float, Field(ge=0, le=10)],
    after: Annotated[float, Field(ge=0, le=10)],
) -> Trial:
    """A dry run with the arm disabled: the link is tested, `motion` checked, zero
    velocity sent on its schedule, and filmed.

    before, after: rest filmed around the movement [s]. Raises what the devices raise.
    """
    commands = pad_commands(motion.commands, before, after)
    with camera, arm:
        arm.check(commands)
        here = dict(zip(JOINTS, arm.angles(), strict=True))
        still = commands.assign(**here, **dict.fromkeys(SPEEDS, 0.0))
        trial = film_motion(still, arm, camera, end=motion.duration + after)
    return mark_distrusted(trial, "dry run with the arm disabled")


def slow_run(
    motion: Motion,
    arm: ArmDevice,
    camera: CameraDevice,
    *,
    before: Annotated[float, Field(ge=0, le=10)],
    after: Annotated[float, Field(ge=0, le=10)],
    share: Annotated[float, Field(gt=0, lt=1)],
) -> Trial:
    """A run along the same path at a share of the speed. before, after: rest filmed
    around the movement [s]. Raises what the devices raise.
    """
    outcome = motion.outcome.assign(duration=motion.duration / share)
    slower = replace(
        motion, commands=slow_commands(motion.commands, share), outcome=outcome
    )
    trial = execute(slower, arm, camera, before=before, after=after)
    return mark_distrusted(trial, f"dry run at {share:g} of the speed")


def slow_commands(commands: pd.DataFrame, share: float) -> pd.DataFrame:
    """Commands (table COMMANDS) along the same path at `share` of the speed, on the
    same tick. Speed falls by `share`, acceleration no less.
    """
    t, angles = commands["t"].to_numpy(), commands[list(JOINTS)].to_numpy()
    tick = float(np.median(np.diff(t)))
    count = int(np.ceil((len(t) - 1) / share)) + 1
    place = np.minimum(np.arange(count) * share, len(t) - 1)
    q = np.stack(
        [np.interp(place, np.arange(len(t)), angle) for angle in angles.T], axis=-1
    )
    w = np.concatenate([np.diff(q, axis=0) / tick, np.zeros((1, q.shape[1]))])
    columns = {"t": t[0] + tick * np.arange(count)}
    return pd.DataFrame(
        columns
        | dict(zip(JOINTS, q.T, strict=True))
        | dict(zip(SPEEDS, w.T, strict=True))
    )
