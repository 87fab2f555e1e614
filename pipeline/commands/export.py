"""Write a run for other programs: MuJoCo, ROS 2, ArviZ, or a table of parameters."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from stringcast.answers import prepare_trials
from stringcast.data.artifacts import COMMANDS, JOINTS
from stringcast.data.estimates import Estimate
from stringcast.data.store import read_table, write_text
from stringcast.known import KnownString, experiment_for_call
from stringcast.measured import read
from stringcast.pipeline.cli.terminal import Terminal
from stringcast.pipeline.commands import CommandParser
from stringcast.pipeline.commands.stored_runs import read_stored_settings
from stringcast.pipeline.run.file_names import artifact_tables
from stringcast.pipeline.settings.composition import UserError
from stringcast.stages.export.mjcf import PLAYER_TEXT, build_mjcf, choose_step
from stringcast.stages.export.mujoco_motion import simulate_chain, tip_distances
from stringcast.stages.export.samples import inference_data
from stringcast.stages.export.trajectory import (
    joint_trajectory,
    trajectory_json,
    write_mcap,
)
from stringcast.stages.inference.prepared_trial import PreparedTrial, prepare_trial
from stringcast.stages.model.model import Model

RUN_HELP = "folder of a diagnosis, an estimation or casts; or an extended.yaml"
FILE_HELP = (
    "by its ending, .xml: the string as MJCF (MuJoCo, Playground, Isaac); .csv: "
    "parameters with units; .nc: posterior samples and log-likelihoods for ArviZ; "
    ".json or .mcap: the last motion as JointTrajectory of ROS 2"
)
MASS_HELP = "of the string [kg], which its motion does not show; for .xml"
CHECK_HELP = "for .xml: simulate the run's own trials in MuJoCo and compare the tip"
MAX_MASS_KG, MAX_STEP_S = 100, 0.1


def main(arguments: list[str]) -> int:
    """Write the file and return the exit status 0."""
    parser = CommandParser("python -m pipeline export", description=__doc__)
    parser.add_argument("run", type=Path, help=RUN_HELP)
    parser.add_argument("file", type=Path, help=FILE_HELP)
    parser.add_argument("--mass", type=float, help=MASS_HELP)
    parser.add_argument("--step", type=float, help="of the simulation [s]; for .xml")
    parser.add_argument("--check", action="store_true", help=CHECK_HELP)
    parser.add_argument(
        "--joints",
        default=",".join(JOINTS),
        help="names of the joints in the robot's description; for .json and .mcap",
    )
    options = parser.parse_args(arguments)
    file: Path = options.file
    if file.suffix not in WRITERS:
        endings = ", ".join(WRITERS)
        raise UserError(
            file,
            "its ending names no format",
            f"Give one of {endings}; python -m pipeline export --help says what "
            "each holds.",
        )
    file.parent.mkdir(parents=True, exist_ok=True)
    WRITERS[file.suffix](options)
    Terminal().print_line(str(file))
    return 0


def write_mjcf(options: argparse.Namespace) -> None:
    """Write the string as MJCF and a script that plays it; optionally compare it.

    Raises UserError for implausible mass or step.
    """
    string = KnownString.from_run(options.run)
    model = experiment_for_call((), string).model
    values = model.values({})
    mass, step = options.mass, options.step
    if (
        mass is None
        or not 0 < mass < MAX_MASS_KG
        or not 0 < (step or 1e-4) < MAX_STEP_S
    ):
        given = f"--mass {mass}" + (f" --step {step}" if step is not None else "")
        raise UserError(
            given,
            "the string's mass must be given in kg, the step in s",
            "Weigh it, and give --mass 0.012.",
        )
    step = step or choose_step(model, values)
    write_text(options.file, build_mjcf(model, values, mass, step))
    player = options.file.with_name("play.py")
    write_text(player, PLAYER_TEXT.format(file=options.file.name))
    Terminal().print_line(f"{player} shows it")
    if options.check:
        for line in compare_with_trials(options.run, string, mass, step):
            Terminal().print_line(line)


def compare_with_trials(
    run: Path, string: KnownString, mass: float, step: float
) -> list[str]:
    """Return lines with the tip errors of MuJoCo and of our model, for each trial."""
    model, trials = trials_of_run(run, string)
    values = model.values({})
    lines = [
        "trial  MuJoCo: rms and largest [mm]  our model [mm]  (tip, from measured)"
    ]
    for trial in trials:
        if trial.initial_state is not None:
            lines.append(f"{trial.name}: left out, it begins with a moving string")
            continue
        hand = model.hand_motion(trial.motion, values[None])
        document = build_mjcf(model, values, mass, step, hand.pose[0, 0], trial.turn)
        moments = model.required_times(values[None], trial.times).ravel()
        chain = simulate_chain(document, hand, moments)
        seen = model.observed_points(chain[None], values[None], trial.times)[0]
        ours = model.simulate_observation(
            trial.motion, values[None], trial.times, turn=trial.turn
        )
        off = 1e3 * tip_distances(trial, seen)
        our_off = 1e3 * tip_distances(trial, ours.points[0])
        rms, our_rms = np.sqrt(np.nanmean(off**2)), np.sqrt(np.nanmean(our_off**2))
        largest, our_largest = np.nanmax(off), np.nanmax(our_off)
        lines.append(
            f"{trial.name}: MuJoCo {rms:.2f} and {largest:.2f}; "
            f"our model {our_rms:.2f} and {our_largest:.2f}"
        )
    return lines


def trials_of_run(run: Path, string: KnownString) -> tuple[Model, list[PreparedTrial]]:
    """Return the model of a string, and the trials that a run made or used.

    Raises UserError for a run without trials.
    """
    settings = read_stored_settings(run)
    given = settings.get("trials")
    trials = read(given or run)
    experiment, data = prepare_trials(trials, ("+experiment=estimate",))
    # arm and camera of the trials
    arm, camera = experiment.model.arm, experiment.model.camera
    model = replace(experiment_for_call((), string).model, arm=arm, camera=camera)
    return model, [prepare_trial(model, trial) for trial in data.trials.values()]


def write_parameters(options: argparse.Namespace) -> None:
    """Write CSV with a row for each parameter and its 95 % interval, if known.

    The paper's parameters are per mass point, at `string.reference_points` points.
    """
    model = experiment_for_call((), KnownString.from_run(options.run)).model
    rows = []
    for parameter in model.parameters:
        low, high = model.measured_ranges.get(parameter.name, (None, None))
        row = {
            "name": parameter.name,
            "symbol": parameter.symbol,
            "value": parameter.start,
            "low": low,
            "high": high,
            "unit": parameter.unit,
            "meaning": parameter.meaning,
        }
        rows.append(row)
    write_text(options.file, pd.DataFrame(rows).to_csv(index=False))


def write_samples(options: argparse.Namespace) -> None:
    """Write the draws of the run's last estimation for ArviZ.

    Raises UserError for a run without draws.
    """
    stored = artifact_tables(options.run, "estimate", "draws")
    draws = pd.read_parquet(stored[-1]) if stored else pd.DataFrame()
    if draws.empty:
        raise UserError(
            options.run,
            "it holds no posterior samples",
            "They are made by an estimation with estimate=least_squares: name "
            "the folder of one.",
        )
    estimated = Estimate.TABLES["parameters"]
    names = read_table(estimated, stored[-1].with_name("parameters.parquet"))["name"]
    string = KnownString.from_run(options.run)
    model, trials = trials_of_run(options.run, string)
    assert set(names) == {parameter.name for parameter in model.parameters}
    data = inference_data(model, trials, draws)
    data.to_netcdf(str(options.file), engine="h5netcdf")


def write_trajectory(options: argparse.Namespace) -> None:
    """Write the commands of the run's last motion for ROS 2.

    Raises UserError for a run without a motion, or unless there are three joints.
    """
    stored = artifact_tables(options.run, "motion", "commands")
    if not stored:
        raise UserError(
            options.run,
            "it holds no motion",
            "Name the folder of a run of casts.",
        )
    names = options.joints.split(",")
    if len(names) != len(JOINTS):
        raise UserError(
            f"--joints {options.joints}",
            f"it names {len(names)} joints, and the motion has three",
            "Try: --joints shoulder,elbow,wrist",
        )
    trajectory = joint_trajectory(read_table(COMMANDS, stored[-1]), names)
    if options.file.suffix == ".mcap":
        write_mcap(trajectory, options.file)
    else:
        write_text(options.file, trajectory_json(trajectory))


WRITERS: dict[str, Callable[[argparse.Namespace], None]] = {
    ".xml": write_mjcf,
    ".csv": write_parameters,
    ".nc": write_samples,
    ".json": write_trajectory,
    ".mcap": write_trajectory,
}
