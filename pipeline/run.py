"""One run, on the terminal and in its folder."""

from __future__ import annotations

from pathlib import Path

from stringcast.pipeline import run_folder
from stringcast.pipeline.experiment import Experiment
from stringcast.pipeline.log import kept
from stringcast.pipeline.result import Result
from stringcast.pipeline.terminal import Terminal


def perform(experiment: Experiment, folder: Path, console: Terminal) -> Result:
    """Run and report; what is in `folder` already is not made again."""
    with run_folder.alone(folder), kept(folder):
        run_folder.begin(experiment, folder)
        with run_folder.failing(folder):
            return experiment.mode.perform(experiment, folder, console)
