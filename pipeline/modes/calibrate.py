"""Mode that calibrates the camera from pictures of a board."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from rich.console import Group
from rich.markup import escape
from rich.text import Text

from stringcast.data import store
from stringcast.data.calibration import Calibration
from stringcast.hardware.camera import Source
from stringcast.pipeline.cli.console import progress_bar, text_table
from stringcast.pipeline.cli.terminal import Terminal
from stringcast.pipeline.modes.stepwise import refuse_trials
from stringcast.pipeline.run.experiment import Experiment, Mode
from stringcast.pipeline.run.iterations import Step
from stringcast.pipeline.run.provenance import step_origin
from stringcast.pipeline.run.result import RunResult
from stringcast.pipeline.settings.composition import Settings, UserError
from stringcast.pipeline.settings.stage_registry import stages
from stringcast.pipeline.settings.typed_settings import build_chosen, build_dataclass
from stringcast.stages.calibrate.board import Board

TILT_REQUEST = "Move the board slowly, tilted in all directions, all over the picture."
HOLD_REQUEST = "Hold the board still in the plane of motion."


@dataclass(frozen=True)
class Calibrate(Mode):
    """Calibration from pictures of a tilted board and of a board in the plane."""

    def check(self, experiment: Experiment) -> None:
        """Refuse stored trials, which a calibration does not use."""
        refuse_trials(experiment)

    def picture_sources(self, config: Settings) -> tuple[str, ...]:
        """Return the names of the sources of pictures."""
        return ("source", "plane")

    def perform(
        self, experiment: Experiment, folder: Path, console: Terminal
    ) -> RunResult:
        """Calibrate and write the page, then refuse an unusable calibration.

        Raises UserError if the calibration cannot be used.
        """
        stage = stages()["calibrate"]
        config = experiment.config
        board = build_dataclass(Board, config["board"], "board", "conf/board")
        tilted = take_pictures(experiment, "source", TILT_REQUEST, console)
        flat = take_pictures(experiment, "plane", HOLD_REQUEST, console)
        with progress_bar("calibrate", console) as progress:
            step = Step(stage, 1, {"tilted": tilted, "flat": flat, "board": board})
            calibration: Calibration = experiment.run_step(step, progress)
            summary = stage.summary(calibration)
            # artifact, page and, if usable, camera.yaml
            origin = step_origin(config, stage.name, experiment.seed, {})
            store.save(calibration, folder / stage.folder, origin)
            report = import_module("stringcast.pipeline.run.report")
            report.write_stage_page(
                experiment, stage, calibration, summary.sentence, folder
            )
            for name, text in stage.files(calibration, folder).items():
                store.write_text(folder / name, text)
        page = folder / "report.html"
        if calibration.reason:
            fault = f"the calibration cannot be used: {calibration.reason}"
            raise UserError("", fault, f"See {page}")
        content = Group(
            Text(summary.sentence),
            text_table(summary.table),
            Text(f"Go on with it: camera_from={folder}", overflow="fold"),
            Text(str(page), overflow="fold"),
        )
        console.print(content, soft_wrap=True)
        return RunResult(folder, (), summary.sentence)


def take_pictures(
    experiment: Experiment, name: str, request: str, console: Terminal
) -> list[object]:
    """Return the pictures of a source; for a live camera, ask the user first."""
    block = experiment.config[name]
    source: Source = build_chosen(block, name, f"conf/source, as {name}")
    return list(source.stills(experiment.camera, lambda: ask_user(request, console)))


def ask_user(request: str, console: Terminal) -> None:
    """Ask the user to prepare the view of the live camera, and wait."""
    try:
        console.input(f"{escape(request)} Press Enter. ")
    except EOFError as error:
        raise UserError(
            "",
            "a calibration from a device needs a person at the terminal",
            "Use images or a video.",
        ) from error
    console.print("Filming, for as many seconds as the settings say ...")
