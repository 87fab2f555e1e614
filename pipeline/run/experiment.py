"""Build the objects and stages of a run from its settings."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from stringcast.pipeline.cli.terminal import Terminal
from stringcast.pipeline.run.iterations import Step
from stringcast.pipeline.run.result import RunResult
from stringcast.pipeline.run.stage_graph import StageGraph
from stringcast.pipeline.settings.bounds import refuse_numbers_out_of_bounds
from stringcast.pipeline.settings.composition import (
    PLUGINS_SETTING,
    Settings,
    UserError,
    flatten_settings,
    group_files,
)
from stringcast.pipeline.settings.model_settings import BlockLocation, build_model
from stringcast.pipeline.settings.named_plugins import (
    import_plugins,
    use_stored_plugins,
)
from stringcast.pipeline.settings.stage_registry import stages
from stringcast.pipeline.settings.typed_settings import (
    bind_stage,
    build_chosen,
    build_dataclass,
    refuse_odd_paths,
    require_block,
)
from stringcast.stages.common import Progress
from stringcast.stages.execute.interfaces import Lab
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.box import Box
from stringcast.stages.model.camera import Camera
from stringcast.stages.model.model import Model
from stringcast.stages.model.string import String
from stringcast.stages.model.target import Target
from stringcast.stages.plugins import load_object
from stringcast.stages.spec import StageCall

SAVEABLE_OUTPUTS = ("frames", "report")
ALL_TRIALS = "all"  # a value of `trials_used`


class Mode(ABC):
    """A loop over stages, chosen by the setting `mode`."""

    @abstractmethod
    def perform(
        self, experiment: Experiment, folder: Path, console: Terminal
    ) -> RunResult:
        """Perform the run in its folder, reuse stored steps, and show the result."""

    @abstractmethod
    def check(self, experiment: Experiment) -> None:
        """Refuse settings that do not fit the mode, before anything is written.

        Raises UserError or DataError, naming the setting and the remedy.
        """

    def graph(self, config: Settings) -> StageGraph:
        """Return the graph of the stages of an iteration; empty for a single stage.

        Raises UserError if the stages cannot be wired.
        """
        return StageGraph()

    def moves_arm(self, config: Settings) -> bool:
        """Return whether an arm is moved, real or virtual."""
        return False

    def picture_sources(self, config: Settings) -> tuple[str, ...]:
        """Return the blocks of settings with the picture sources in use."""
        films = config["hardware"].get("source") is not None
        return ("source",) if films and self.moves_arm(config) else ()


@dataclass(frozen=True)
class Experiment:
    """The objects of a run; implements `stages.spec.StageSetup`.

    Parameters
    ----------
    config : mapping
        All settings of the run.
    model : Model
        String, arm and camera with the modelled effects.
    target : Target
        Target of the tip.
    obstacles : tuple of Box
        What the string must not touch.
    stages : mapping
        Functions with bound settings, by stage.
    mode : Mode
        Loop over the stages.
    """

    config: Settings
    model: Model
    target: Target
    obstacles: tuple[Box, ...]
    stages: Mapping[str, Callable[..., Any]]
    mode: Mode

    @property
    def arm(self) -> Arm:
        """Arm of the model."""
        return self.model.arm

    @property
    def camera(self) -> Camera:
        """Camera of the model."""
        return self.model.camera

    @property
    def string(self) -> String:
        """String of the model."""
        return self.model.string

    @property
    def seed(self) -> int:
        """Seed of the whole run."""
        return int(self.config["seed"])

    @property
    def effects_per_recording(self) -> list[str]:
        """Effects whose values vary between trials."""
        return list(self.config["effects_per_recording"])

    def lab(self, trial: int) -> Lab:
        """Return arm and camera, real or virtual, for the trial of an iteration."""
        open_lab = self.stages["hardware"]
        return open_lab(self.arm, self.camera, seed=self.seed, trial=trial)

    def run_step(self, step: Step, progress: Progress) -> Any:
        """Run the stage of a step and return its artifact."""
        bound_function = self.stages.get(step.stage.name)
        seed = step.derive_seed(self.seed)
        call = StageCall(bound_function, self, seed, step.number, progress)
        artifact = load_object(step.stage.run)(call, **step.inputs)
        if not isinstance(artifact, step.stage.makes):
            kind, wanted = type(artifact).__name__, step.stage.makes.__name__
            raise UserError(
                f"stage {step.stage.name}",
                f"{step.stage.run} returned {kind}, not {wanted}",
                "Correct it.",
            )
        return artifact


def prepare_experiment(config: Settings, where: BlockLocation) -> Experiment:
    """Check all settings and build the experiment, before anything moves.

    `where` returns the file of a block of settings, for messages. Raises UserError,
    DataError or PluginError for a setting or a plugin that cannot be used.
    """
    use_stored_plugins(config, where(PLUGINS_SETTING))
    import_plugins()
    check_run_settings(config, where)
    target = build_dataclass(Target, config["target"], "target", where("target"))
    model = build_model(config, where)
    obstacles = build_obstacles(config["obstacles"], where("obstacles"))
    functions = {}
    for name in (*stages(), "hardware"):
        if name in config and not holds_only_inputs(config[name]):
            functions[name] = bind_stage(config[name], name, where(name))
    mode = build_chosen(config["mode"], "mode", where("mode"))
    experiment = Experiment(config, model, target, obstacles, functions, mode)
    mode.check(experiment)
    refuse_lacking_settings(mode.graph(config).stages, functions, where("mode"))
    return experiment


def build_obstacles(block: Any, where: str) -> tuple[Box, ...]:
    """Build the boxes that the string must not touch."""
    boxes = require_block(block, "obstacles", where)["boxes"]
    if not isinstance(boxes, list):
        setting = f"obstacles.boxes = {boxes!r} ({where})"
        raise UserError(setting, "it must be a list", "Change it.")
    obstacles = []
    for number, box in enumerate(boxes):
        obstacles.append(build_dataclass(Box, box, f"obstacles.boxes.{number}", where))
    return tuple(obstacles)


def holds_only_inputs(block: Any) -> bool:
    """Return whether a stage's block names only sources of inputs."""
    return isinstance(block, Mapping) and set(block) == {"inputs"}


def refuse_lacking_settings(
    names: Iterable[str], functions: Mapping[str, Any], where: str
) -> None:
    """Raise UserError for a stage without the settings of its function."""
    for name in names:
        if stages()[name].by and name not in functions:
            options = [file.stem for file in group_files(name)] or ["..."]
            raise UserError(
                f"stage {name} ({where})",
                "its settings are missing",
                f"Choose +{name}={' or '.join(options)}.",
            )


def check_run_settings(config: Settings, where: BlockLocation) -> None:
    """Raise UserError for a number that cannot be used, or a setting of the run."""
    refuse_numbers_out_of_bounds(config, where)
    refuse_odd_paths(config, where("trials"))
    for name, value in flatten_settings(config).items():
        numbers = value if isinstance(value, list) else [value]
        for number in numbers:
            if isinstance(number, float) and not math.isfinite(number):
                place = where(name.partition(".")[0])
                raise UserError(
                    f"{name} = {number} ({place})",
                    "it must be a finite number",
                    "Change it.",
                )

    def refuse(name: str, requirement: str) -> NoReturn:
        setting = f"{name} = {config[name]!r} ({where(name)})"
        raise UserError(setting, f"it must be {requirement}", "Change it.")

    for name, least in {"max_casts": 1, "seed": 0, "workers": 0}.items():
        if type(config[name]) is not int:
            refuse(name, f"a whole number from {least}")
    if config["trials_used"] != ALL_TRIALS and type(config["trials_used"]) is not int:
        refuse("trials_used", f"a whole number from 1, or {ALL_TRIALS}")
    saved = config["saved_outputs"]
    if not isinstance(saved, list) or any(x not in SAVEABLE_OUTPUTS for x in saved):
        refuse("saved_outputs", f"a list of {', '.join(SAVEABLE_OUTPUTS)}")
