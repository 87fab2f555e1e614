"""A calibration: pictures taken of a board, the camera measured, camera.yaml and the page in the run's folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from rich.console import Group
from rich.markup import escape
from rich.text import Text

from stringcast.data import store
from stringcast.data.calibration import Calibration
from stringcast.hardware.camera import Source
from stringcast.pipeline.console import bars, listed
from stringcast.pipeline.experiment import Experiment, Mode
from stringcast.pipeline.iterations import Step
from stringcast.pipeline.modes.stepwise import needs_none
from stringcast.pipeline.provenance import origin
from stringcast.pipeline.registry import stages
from stringcast.pipeline.result import Result
from stringcast.pipeline.settings import UserError, build, chosen
from stringcast.pipeline.terminal import Terminal
from stringcast.stages.calibrate.board import Board

TILT = "Move the board slowly, tilted in all directions, all over the picture."
HOLD = "Hold the board still in the plane of motion."


@dataclass(frozen=True)
class Calibrate(Mode):
    """Pictures of the board tilted in all directions, and of one held in the plane of motion, of whatever source."""

    def check(self, experiment: Experiment) -> None:
        needs_none(experiment)

    def sources(self, config: Mapping[str, Any]) -> tuple[str, ...]:
        return ("source", "plane")

    def perform(self, experiment: Experiment, folder: Path, console: Terminal) -> Result:
        """Calibrate, write the page, then raise UserError for a calibration that cannot be used."""
        stage = stages()["calibrate"]
        board = build(Board, experiment.config["board"], "board", "conf/board")
        tilted = pictures(experiment, "source", TILT, console)
        flat = pictures(experiment, "plane", HOLD, console)
        with bars(console) as bar, bar("calibrate") as progress:
            step = Step(stage, 1, {"tilted": tilted, "flat": flat, "board": board})
            made: Calibration = experiment.run(step, progress)
            # the artifact, the page and, of a good one, camera.yaml
            sentence = stage.summary(made).sentence
            store.save(made, folder / stage.folder, origin(experiment.config, stage.name, experiment.seed, {}))
            import_module("stringcast.pipeline.report").write_page(experiment, stage, made, sentence, folder)
            for name, text in stage.files(made, folder).items():
                store.write_text(folder / name, text)
        if made.reason:
            raise UserError(f"the calibration cannot be used: {made.reason} See {folder / 'report.html'}")
        ahead = (f"Go on with it: calibrated={folder}", str(folder / "report.html"))
        lines = (Text(line, overflow="fold") for line in ahead)
        console.print(Group(Text(sentence), listed(stage.summary(made).table), *lines), soft_wrap=True)
        return Result(folder, (), sentence)


def pictures(experiment: Experiment, name: str, ask: str, console: Terminal) -> list[object]:
    """The pictures of one of the sources, as configured. ask: request to the user before a live camera films."""
    source: Source = chosen(experiment.config[name], name, f"conf/source, as {name}")
    return list(source.stills(experiment.camera, lambda: asked(ask, console)))


def asked(words: str, console: Terminal) -> None:
    """Tell a person what to do before a live camera, and wait until it can film."""
    try:
        console.input(f"{escape(words)} Press Enter. ")
    except EOFError as error:
        raise UserError("a calibration from a device needs a person at the terminal. Use images or a video.") from error
    console.print("Filming, for as many seconds as the settings say ...")
