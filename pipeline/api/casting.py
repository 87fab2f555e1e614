"""Plan, simulate and perform motions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from stringcast.data.artifacts import JOINTS, Motion
from stringcast.data.schema import DataError
from stringcast.known import KnownString, experiment_for_call, model_for_call
from stringcast.pipeline.cli.console import progress_bar
from stringcast.pipeline.cli.terminal import Terminal
from stringcast.pipeline.run.cost import LIMIT, ask_about_cost
from stringcast.pipeline.run.result import RunResult
from stringcast.pipeline.run.single_run import perform_run
from stringcast.stages.model.hand import resample_joint_motion


def generate(
    string: KnownString | None = None,
    *settings: str,
    target: tuple[float, float],
    seed: int = 0,
) -> Motion:
    """Plan a motion whose simulated tip enters the target box.

    Parameters
    ----------
    string : KnownString, optional
        What is known of the string.
    *settings : str
        Settings as on the command line, such as "generate=robust" or "target.w=0.03".
    target : tuple of float
        Centre (x, y) of the target box [m].
    seed : int
        Seed of the random search.

    Returns
    -------
    Motion
        Its table `commands` has joint angles [rad] and velocities [rad/s] every 5 ms.

    Raises
    ------
    StringcastError
        If the target is out of reach or no motion is found.
    """
    place = (f"target.x={target[0]}", f"target.y={target[1]}", f"seed={seed}")
    experiment = experiment_for_call((*place, *settings), string)
    with progress_bar("generate") as progress:
        motion: Motion = experiment.stages["generate"](
            experiment.model,
            experiment.target,
            experiment.obstacles,
            None,
            None,
            seed=experiment.seed,
            progress=progress,
        )
    return motion


def simulate(
    string: KnownString | None,
    motion: Motion | pd.DataFrame,
    *settings: str,
    times: Sequence[float] | None = None,
) -> pd.DataFrame:
    """Simulate the string along a motion.

    Parameters
    ----------
    string : KnownString or None
        What is known of the string. Unknown parameters take the start values of a soft
        string.
    motion : Motion or DataFrame
        A planned motion, or a table with t [s] and q1, q2, q3 [rad].
    *settings : str
        Settings as on the command line.
    times : sequence of float, optional
        Times of the output [s]; those of the motion by default.

    Returns
    -------
    DataFrame
        A row for each time and mass point, with t [s], s, x, y [m].

    Raises
    ------
    StringcastError
        If the simulation does not stay finite.
    """
    model = model_for_call(settings, string)
    table = motion.commands if isinstance(motion, Motion) else motion
    motion_times = table["t"].to_numpy(dtype=float)
    angles = table[list(JOINTS)].to_numpy(dtype=float)
    hand = resample_joint_motion(motion_times, angles, model.arm.tick)
    t = motion_times if times is None else np.asarray(times, dtype=float)
    simulated = model.simulate_string(hand, model.values({})[None], t)
    if not simulated.finite[0]:
        raise DataError(
            "simulate()",
            "this string does not stay finite in this motion",
            "Reduce string.largest_step.",
        )
    s = model.string.arc_lengths()
    points = simulated.points[0].reshape(-1, 2)  # (T n, 2)
    return pd.DataFrame(
        {
            "t": t.repeat(len(s)),
            "s": np.tile(s, len(t)),
            "x": points[:, 0],
            "y": points[:, 1],
        }
    )


def cast(
    folder: str | Path, *settings: str, string: KnownString | None = None
) -> RunResult:
    """Cast until the tip hits, like `python -m pipeline`.

    Parameters
    ----------
    folder : str or Path
        Folder of the run. An existing run is continued.
    *settings : str
        Settings as on the command line, such as "+experiment=stringB" or
        "hardware=serial". The default is the virtual lab.
    string : KnownString, optional
        What is known of the string.

    Returns
    -------
    RunResult
        Outcome and folder of the run.

    Raises
    ------
    StringcastError
        If a setting cannot be used, or the hardware fails.
    """
    experiment = experiment_for_call(settings, string)
    console = Terminal(stderr=True)
    ask_about_cost(experiment, experiment.config[LIMIT], console)
    return perform_run(experiment, Path(folder), console)
