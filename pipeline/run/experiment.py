"""From a composed configuration to the objects and stages of one run."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from hydra.utils import get_object

from stringcast.pipeline.cli.terminal import Terminal
from stringcast.pipeline.run.iterations import Step
from stringcast.pipeline.run.result import RunResult
from stringcast.pipeline.settings.composition import UserError
from stringcast.pipeline.settings.stage_registry import stages
from stringcast.pipeline.settings.typed_settings import (
    bind_stage,
    build_chosen,
    build_dataclass,
    load_callable,
)
from stringcast.stages.common import Progress
from stringcast.stages.execute.interfaces import Lab
from stringcast.stages.generate.curves import plain_cast
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.box import Box
from stringcast.stages.model.camera import Camera
from stringcast.stages.model.engine.accuracy import (
    ToleranceError,
    find_converged_string,
)
from stringcast.stages.model.hand import JointMotion
from stringcast.stages.model.library import effect_files, find_effects
from stringcast.stages.model.model import Model
from stringcast.stages.model.string import String
from stringcast.stages.spec import StageCall

BlockLocation = Callable[[str], str]


class Mode(ABC):
    """A loop over stages: `mode` in the settings of a run."""

    @abstractmethod
    def perform(
        self, experiment: Experiment, folder: Path, console: Terminal
    ) -> RunResult:
        """The whole run, kept in a folder and shown on the terminal. What is there
        already is not made again.
        """

    @abstractmethod
    def check(self, experiment: Experiment) -> None:
        """Raise UserError or DataError for settings that the mode cannot work with,
        before anything is written.
        """

    def moves_arm(self, config: Mapping[str, Any]) -> bool:
        """Whether an arm is moved, real or not."""
        return False

    def picture_sources(self, config: Mapping[str, Any]) -> tuple[str, ...]:
        """The settings that name where the pictures come from which are looked at."""
        return (
            ("source",)
            if "source" in config["hardware"] and self.moves_arm(config)
            else ()
        )


@dataclass(frozen=True)
class Experiment:
    """All that a run works with; `stages` are functions with their settings bound.
    Fills `stages.spec.StageSetup`.
    """

    config: Mapping[str, Any]
    model: Model
    target: Box
    obstacles: tuple[Box, ...]
    stages: Mapping[str, Callable[..., Any]]
    mode: Mode

    @property
    def arm(self) -> Arm:
        """The model's arm."""
        return self.model.arm

    @property
    def camera(self) -> Camera:
        """The model's camera."""
        return self.model.camera

    @property
    def string(self) -> String:
        """The model's string."""
        return self.model.string

    @property
    def seed(self) -> int:
        """The run's seed."""
        return int(self.config["seed"])

    @property
    def effects_per_recording(self) -> list[str]:
        """Effects whose values differ from one trial to another."""
        return list(self.config["effects_per_recording"])

    def lab(self, trial: int) -> Lab:
        """Arm and camera, real or virtual. trial: number of the iteration."""
        made: Lab = self.stages["hardware"](
            self.arm, self.camera, seed=self.seed, trial=trial
        )
        return made

    def run_step(self, step: Step, progress: Progress) -> Any:
        """The artifact of a step, made now."""
        stage = step.stage
        call = StageCall(
            self.stages.get(stage.name),
            self,
            step.derive_seed(self.seed),
            step.number,
            progress,
        )
        return get_object(f"stringcast.{stage.run}")(call, **step.inputs)


def prepare_experiment(config: Mapping[str, Any], where: BlockLocation) -> Experiment:
    """Check everything before anything moves or is written. where: the file of a block."""
    check_run_settings(config, where)
    arm = build_dataclass(Arm, config["arm"], "arm", where("arm"))
    target = build_dataclass(Box, config["target"], "target", where("target"))
    string = refine_string_to_tolerance(
        build_string(config["string"], where("string")), arm, config, where("string")
    )
    camera = build_dataclass(Camera, config["camera"], "camera", where("camera"))
    plain = Model(string, arm, camera)
    model = add_effects(plain, config["effects"], where("effects"))
    add_effects(
        plain,
        config["effects_per_recording"],
        where("effects_per_recording"),
        "effects_per_recording",
    )  # they need not be at work
    known, measured = read_parameter_values(
        config["parameter_values"], model, where("parameter_values")
    )
    model = replace(model, start_values=known, measured_ranges=measured)
    boxes = config["obstacles"]["boxes"]
    experiment = Experiment(
        config,
        model,
        target,
        tuple(
            build_dataclass(Box, box, f"obstacles.boxes.{i}", where("obstacles"))
            for i, box in enumerate(boxes)
        ),
        {
            name: bind_stage(config[name], name, where(name))
            for name in (*stages(), "hardware")
            if name in config
        },
        build_chosen(config["mode"], "mode", where("mode")),
    )
    experiment.mode.check(experiment)
    return experiment


SAVEABLE_OUTPUTS = ("frames", "report")
ALL_TRIALS = "all"  # of the trials, which `trials_used` may be


def check_run_settings(config: Mapping[str, Any], where: BlockLocation) -> None:
    """The few settings of the run itself."""
    for name, other in (("max_casts", ""), ("trials_used", f", or {ALL_TRIALS}")):
        if (type(config[name]) is not int or config[name] < 1) and not (
            other and config[name] == ALL_TRIALS
        ):
            must = f"it must be a whole number from 1{other}"
            raise UserError(
                f"{name} = {config[name]!r} ({where(name)}): {must}. Change it."
            )
    if type(config["seed"]) is not int or config["seed"] < 0:
        raise UserError(
            f"seed = {config['seed']!r} ({where('seed')}): it must be a whole number from 0. Change it."
        )
    if not isinstance(config["saved_outputs"], list) or not set(
        config["saved_outputs"]
    ) <= set(SAVEABLE_OUTPUTS):
        choices = ", ".join(SAVEABLE_OUTPUTS)
        raise UserError(
            f"saved_outputs = {config['saved_outputs']} ({where('saved_outputs')}): it must be a list of {choices}. Change it."
        )


def add_effects(
    model: Model, names: Any, where: str, setting: str = "effects"
) -> Model:
    """The model with the effects of these names. setting: that gives them. Raises
    UserError.
    """
    if not isinstance(names, list):
        raise UserError(
            f"{setting} = {names!r} ({where}): it must be a list, such as [rest_curvature]. Change it."
        )
    try:
        return model.with_effects(*find_effects([str(name) for name in names]))
    except ValueError as error:
        raise UserError(f"{setting} ({where}): {error}") from error


def read_parameter_values(
    block: Any, model: Model, where: str
) -> tuple[dict[str, float], dict[str, tuple[float, float]]]:
    """Values of parameters that are known from before, and the ranges of those that
    were measured.
    """
    by_name: dict[str, Any] = {}
    # on the command line, +parameter_values.tip_mass.ratio=0.05 is a block in a block
    for name, given in block.items():
        apart = isinstance(given, Mapping) and "value" not in given
        by_name |= (
            {f"{name}.{inner}": value for inner, value in given.items()}
            if apart
            else {name: given}
        )
    values, ranges = {}, {}
    for name, given in by_name.items():
        if name not in model.names:
            effect = name.partition(".")[0]
            remedy = f"Known are: {', '.join(model.names)}"
            if effect in effect_files():
                remedy = f"Model it: 'effects=[{effect}]' '+parameter_values.{effect}.<parameter>=<number>'"
            raise UserError(
                f"parameter_values.{name} ({where}): there is no such parameter of what is modelled. {remedy}."
            )
        # a number, or a value with its interval where it was measured
        measured = isinstance(given, Mapping) and set(given) == {"value", "low", "high"}
        parts = [given["value"], given["low"], given["high"]] if measured else [given]
        if not all(
            isinstance(part, float | int) and math.isfinite(part) for part in parts
        ):
            raise UserError(
                f"parameter_values.{name} = {given!r} ({where}): it must be a number, or value, low and high if it was measured. "
                "Change it."
            )
        values[name] = float(parts[0])
        if measured:
            value, low, high = parts
            if not (low < high and low <= value <= high):
                ends = f"low = {low} < high = {high} must enclose value = {value}"
                raise UserError(
                    f"parameter_values.{name} ({where}): {ends}. Change it."
                )
            ranges[name] = float(low), float(high)
    return values, ranges


def build_string(block: Mapping[str, Any], where: str) -> String:
    """The string model, with the ranges of its parameters."""
    apart = ("ranges", "tolerance", "integrator")
    settings = {key: value for key, value in block.items() if key not in apart}
    plain = build_dataclass(String, settings, "string", where)
    known = {p.name: p for p in plain.parameters}
    integrator = load_callable(
        block["integrator"]["_target_"], "string.integrator", where
    )
    if len(block["integrator"]) > 1:
        asked = dict(block["integrator"])
        raise UserError(
            f"string.integrator = {asked} ({where}): it must hold only `_target_`. Change it."
        )
    ranges = {}
    for name, limits in block["ranges"].items():
        if name not in known:
            raise UserError(
                f"string.ranges.{name} ({where}): there is no such parameter. Known are: {', '.join(known)}."
            )
        low, high, start = (float(limits[key]) for key in ("low", "high", "start"))
        if not low < high:
            raise UserError(
                f"string.ranges.{name} ({where}): low = {low} must be below high = {high}. Change one."
            )
        if not low <= start <= high:
            raise UserError(
                f"string.ranges.{name}.start = {start} ({where}): it must lie from {low} to {high}. Change it."
            )
        ranges[name] = replace(known[name], low=low, high=high, start=start)
    return replace(plain, ranges=ranges, integrator=integrator())


def refine_string_to_tolerance(
    string: String, arm: Arm, config: Mapping[str, Any], where: str
) -> String:
    """The string with points and step that keep `string.tolerance`, if there is one.

    Measured on one plain cast of the arm, with all parameters in the middle of their
    ranges.
    """
    tolerance = config["string"]["tolerance"]
    if tolerance is None:
        return string
    if not isinstance(tolerance, float | int) or tolerance <= 0:
        raise UserError(
            f"string.tolerance = {tolerance!r} ({where}): it must be metres above 0, or null. Change it."
        )
    cast = plain_cast(
        arm,
        float(np.sqrt(config["generate"]["shortest"] * config["generate"]["longest"])),
    )
    hand = JointMotion(
        0.0, arm.tick, *cast.sample(arm.tick, float(cast.duration[0]))
    ).hand_motion(arm)
    try:
        return find_converged_string(
            string,
            hand,
            np.array([p.value(np.array(0.5)) for p in string.parameters]),
            tolerance,
        ).string
    except ToleranceError as error:
        raise UserError(f"string.tolerance = {tolerance} ({where}): {error}") from error
