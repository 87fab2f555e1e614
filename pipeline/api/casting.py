"""Motions: found, simulated and performed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from stringcast.answers import progress_bar
from stringcast.data.artifacts import JOINTS, Motion
from stringcast.data.schema import DataError
from stringcast.known import KnownString, experiment_for_call, model_for_call
from stringcast.pipeline.cli.terminal import Terminal
from stringcast.pipeline.run.result import RunResult
from stringcast.pipeline.run.single_run import perform_run
from stringcast.stages.model.hand import resample_joint_motion


def generate(
    string: KnownString | None = None,
    *settings: str,
    target: tuple[float, float],
    seed: int = 0,
) -> Motion:
    """A motion whose simulated tip enters the target box. Its `commands` are joint
    angles and velocities each 5 ms.

    string: what is known of it. target: centre of the box (x, y) [m]; its size is
    target.w and target.h. settings: words as on the command line, such as
    "generate=robust". Raises StringcastError where the target is out of reach or no
    motion is found.
    """
    place = (f"target.x={target[0]}", f"target.y={target[1]}", f"seed={seed}")
    here = experiment_for_call((*place, *settings), string)
    with progress_bar("generate") as progress:
        made: Motion = here.stages["generate"](
            here.model,
            here.target,
            here.obstacles,
            None,
            None,
            seed=here.seed,
            progress=progress,
        )
        return made


def simulate(
    string: KnownString | None,
    motion: Motion | pd.DataFrame,
    *settings: str,
    times: Sequence[float] | None = None,
) -> pd.DataFrame:
    """The string along a motion: a row for each moment and mass point, with t [s], s,
    x, y [m].

    string: what is known of it; what is not is at its start, from where it is sought:
    softer than strings are. motion: one that was generated, or a table with t [s] and
    q1, q2, q3 [rad]. times: when the string is wanted [s], at the motion's own times
    without it. Raises StringcastError where the simulation does not stay finite.
    """
    model = model_for_call(settings, string)
    table = motion.commands if isinstance(motion, Motion) else motion
    moved = table["t"].to_numpy(dtype=float)
    t = moved if times is None else np.asarray(times, dtype=float)
    hand = resample_joint_motion(
        moved, table[list(JOINTS)].to_numpy(dtype=float), model.arm.tick
    )
    seen = model.simulate_string(hand, model.values({})[None], t)
    if not seen.finite[0]:
        raise DataError(
            "simulate(): this string does not stay finite in this motion. Give string.largest_step less."
        )
    s = model.string.arc_lengths()
    columns: dict[str, Any] = {"t": t.repeat(len(s)), "s": np.tile(s, len(t))}
    return pd.DataFrame(
        columns | dict(zip(("x", "y"), seen.points[0].reshape(-1, 2).T, strict=True))
    )


def cast(
    folder: str | Path, *settings: str, string: KnownString | None = None
) -> RunResult:
    """Cast until the tip hits, as `python -m pipeline` does; by default on the virtual
    lab.

    folder: for all that the run leaves; given again, the run goes on. settings: words
    as on the command line, such as "+experiment=stringB" or "hardware=serial". string:
    what is known of it. Raises StringcastError.
    """
    here = experiment_for_call(settings, string)
    return perform_run(here, Path(folder), Terminal(stderr=True))
