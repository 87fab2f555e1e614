"""Estimate the cost of a run's steps, and ask before one takes hours.

The estimates are rough: processor time is proportional to the points and steps of all
simulated strings, or to the pixels of all frames. A stage function declares how many
strings it simulates (`stages.spec`); otherwise it counts as free.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stringcast.data import dataset
from stringcast.pipeline.cli.terminal import Terminal
from stringcast.pipeline.run.experiment import ALL_TRIALS, Experiment
from stringcast.pipeline.settings.composition import Settings, UserError, setting_of
from stringcast.pipeline.settings.stage_registry import stages
from stringcast.stages.plugins import load_object
from stringcast.stages.spec import string_counts

LIMIT = "max_core_hours"
ESTIMATION = "estimate"  # the stage to which `trials_used` applies
HOUR_S = 3600.0
# Measured with the paper's strings on one core (tests/benchmarks/speed/README.md).
POINT_STEP_S = 2e-8  # [s] per mass point and simulation step
PIXEL_S = 3e-8  # [s] per rendered or read pixel


@dataclass(frozen=True)
class StepCost:
    """Rough cost of the most expensive step of a stage.

    Parameters
    ----------
    stage : str
        Name of the stage.
    core_hours : float
        Processor time [h].
    settings : mapping
        Settings that determine the cost, with values.
    """

    stage: str
    core_hours: float
    settings: Mapping[str, Any]

    def describe(self) -> str:
        """Describe the cost with the settings that determine it."""
        causes = [f"{name} = {value}" for name, value in self.settings.items()]
        return (
            f"stage {self.stage} would take some {self.core_hours:.3g} h of a core "
            f"({', '.join(causes)})"
        )


def ask_about_cost(
    experiment: Experiment,
    limit_hours: float,
    console: Terminal,
    consent: str = f"{LIMIT}=",
) -> None:
    """Ask a person before a run with a step that costs more than a limit.

    The limit is that of this user, not of a stored run. `consent` is the option by
    which a person agrees, without the number of hours. Raises UserError without a
    terminal, or if the answer is no.
    """
    costs = estimate_costs(experiment)
    if not costs:
        return
    highest = max(costs, key=lambda cost: cost.core_hours)
    if highest.core_hours <= limit_hours:
        return
    fault = f"{highest.describe()}, more than {LIMIT} = {limit_hours:g}."
    if console.is_terminal and sys.stdin.isatty():
        console.print_line(fault)
        if console.input("Begin all the same? (y/N) ").strip().lower() == "y":
            return
    raise UserError(
        "",
        f"{fault} Nothing was begun",
        "Change one of these settings, or allow it: "
        f"{consent}{highest.core_hours * 1.5:.2g}",
    )


def estimate_costs(experiment: Experiment) -> list[StepCost]:
    """Return the cost of a step for each stage; empty for a calibration."""
    config = experiment.config
    names = experiment.mode.graph(config).stages
    if not names:
        return []
    trials = _planned_trials(config, names)
    if config["trials"] is not None:
        trials = _stored_trials(Path(config["trials"]))
    costs = []
    for name in names:
        stage = stages()[name]
        counts: Mapping[str, float] = {}
        if name in experiment.stages:
            block = config[name]
            counts = string_counts(load_object(block["_target_"]), block)
        if counts:
            costs.append(_simulation_cost(experiment, name, counts, trials))
        elif stage.takes_frames or stage.moves_arm:
            costs.append(_frame_cost(experiment, name, trials))
    return costs


@dataclass(frozen=True)
class Trials:
    """Planned or stored trials.

    Parameters
    ----------
    seconds : tuple of float
        Duration of each [s].
    frames : float
        Largest number of frames of a trial.
    settings : mapping
        Settings that determine both, with values.
    """

    seconds: tuple[float, ...]
    frames: float
    settings: Mapping[str, Any]


def _planned_trials(config: Settings, names: Sequence[str]) -> Trials:
    """Return planned casts, each as long as the longest movement."""
    movements = []
    if "excite" in names:
        movements.append("excite.duration")
    if "generate" in names or not movements:
        movements.append("generate.longest")
    durations = _given_numbers(config, movements)
    settings = _given_numbers(config, ["execute.before", "execute.after"])
    if durations:
        longest = max(durations, key=lambda name: durations[name])
        settings = {longest: durations[longest], **settings}
    seconds = float(sum(settings.values()))
    frames = seconds * config["camera"]["fps"]
    return Trials((seconds,) * config["max_casts"], frames, settings)


def _given_numbers(config: Settings, names: Sequence[str]) -> dict[str, float]:
    """Return the named settings that are numbers."""
    numbers = {}
    for name in names:
        value = setting_of(config, name)
        if isinstance(value, int | float):
            numbers[name] = value
    return numbers


def _stored_trials(folder: Path) -> Trials:
    """Return the trials of a folder."""
    data = dataset.read_dataset(folder)
    seconds: list[float] = []
    for trial in data.trials.values():
        hand = trial.grasp if trial.arm is None else trial.arm
        assert hand is not None
        seconds.append(float(np.ptp(hand["t"])) if len(hand) else 0.0)
    frames = max((len(film.t) for film in data.films.values()), default=0)
    total = f"{sum(seconds):.3g} s in {len(seconds)} trials of {folder}"
    return Trials(tuple(seconds), frames, {"trials": total})


def _simulation_cost(
    experiment: Experiment, name: str, counts: Mapping[str, float], trials: Trials
) -> StepCost:
    """Return the cost of a stage that simulates strings."""
    config, string = experiment.config, experiment.string
    block = config[name]
    if stages()[name].collected_input:
        longest_first = sorted(trials.seconds, reverse=True)
        if name == ESTIMATION and config["trials_used"] != ALL_TRIALS:
            longest_first = longest_first[: int(config["trials_used"])]
        seconds = sum(longest_first)
        durations = trials.settings
    else:
        seconds = block["longest"]
        durations = {f"{name}.longest": seconds}
    steps = seconds / string.largest_step
    core_seconds = sum(counts.values()) * steps * string.points * POINT_STEP_S
    settings = {f"{name}.{key}": block[key] for key in counts} | dict(durations)
    settings["string.points"] = string.points
    settings["string.largest_step"] = string.largest_step
    return StepCost(name, core_seconds / HOUR_S, settings)


def _frame_cost(experiment: Experiment, name: str, trials: Trials) -> StepCost:
    """Return the cost of a stage that renders or reads all frames of a trial."""
    camera = experiment.camera
    core_seconds = trials.frames * camera.width * camera.height * PIXEL_S
    sizes = {"width": camera.width, "height": camera.height, "fps": camera.fps}
    settings = {f"camera.{key}": value for key, value in sizes.items()}
    return StepCost(name, core_seconds / HOUR_S, settings | dict(trials.settings))
