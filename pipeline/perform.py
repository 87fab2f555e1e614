"""One run from its settings to its report, on the terminal and in its folder."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

from rich.markup import escape

from stringcast.pipeline import run_folder
from stringcast.pipeline.console import bars, summary
from stringcast.pipeline.experiment import Experiment
from stringcast.pipeline.layout import ENDED
from stringcast.pipeline.log import kept
from stringcast.pipeline.run import Result, work
from stringcast.pipeline.settings import UserError
from stringcast.pipeline.terminal import Terminal
from stringcast.stages.execute.interfaces import HardwareError

STUDIES = {
    "study": "study.command",
    "extraction_study": "extraction_study.command",
    "hit_study": "hitting.study",
    "measured_study": "measured.study",
}


def module(name: str) -> Any:
    """A module of the pipeline that draws: it is loaded when it is needed, for that takes a second and more."""
    return import_module(f"stringcast.pipeline.{name}")


def perform(here: Experiment, folder: Path, console: Terminal) -> Result:
    """Run and report; what is in `folder` already is not made again."""
    with run_folder.alone(folder), kept(folder):
        run_folder.begin(here, folder)
        with run_folder.failing(folder):
            if here.config["steps"] == ["calibrate"]:
                return calibration(here, folder, console)
            if here.config["steps"][0] in STUDIES:
                return studied(here, folder, console)
            return cast_or_look_again(here, folder, console)


def cast_or_look_again(here: Experiment, folder: Path, console: Terminal) -> Result:
    """All but a study. The report comes before run.json, which says that all is there."""
    if "execute" in here.config["steps"] and not (folder / ENDED).exists():
        check_devices(here)
    with bars(console) as bar:
        result = work(here, folder, run_folder.RunFolder(here, folder, bar, lambda words: console.print(escape(words))))
        if "report" in here.config["leave"]:
            with bar("report"):
                module("report").write(here, result)
        run_folder.end(result)
    if "frames" not in here.config["leave"]:
        run_folder.without_frames(here, result)
    console.print(summary(result))
    return result


def check_devices(here: Experiment) -> None:
    """Open arm and camera before anything is planned for them. Raises HardwareError with all that is wrong of both."""
    lab = here.stages["hardware"](here.arm, here.camera, seed=here.seed, trial=1)
    faults = []
    for device in (lab.arm, lab.camera):
        try:
            with device:
                pass
        except HardwareError as error:
            faults.append(str(error))
    if faults:
        raise HardwareError("\n".join(faults))


def calibration(here: Experiment, folder: Path, console: Terminal) -> Result:
    """The camera on the terminal and as camera.yaml in the folder, with the page; raises UserError for a bad one."""
    calibrate = module("calibrate")
    looked = calibrate.taken(here, lambda words: asked(words, console))
    with bars(console) as bar, bar("calibrate") as progress:
        made = calibrate.run(here, folder, looked, progress)
    calibrate.refuse(made, folder)
    console.print(calibrate.summary(made, folder), soft_wrap=True)
    return Result(folder, (), calibrate.sentence(made))


def asked(words: str, console: Terminal) -> None:
    """Tell a person what to do before a live camera, and wait until it can film."""
    try:
        console.input(f"{escape(words)} Press Enter. ")
    except EOFError as error:
        raise UserError("a calibration from a device needs a person at the terminal. Use images or a video.") from error
    console.print("Filming, for as many seconds as the settings say ...")


def studied(here: Experiment, folder: Path, console: Terminal) -> Result:
    """Its scores on the terminal, its tables and pictures in the folder."""
    study = module(STUDIES[here.config["steps"][0]])
    with bars(console) as bar, bar(here.config["name"]) as progress:
        sentence = study.run(here, folder, progress)
    console.print(sentence, soft_wrap=True, markup=False)
    return Result(folder, (), sentence)
