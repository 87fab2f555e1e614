"""A run that is many: benches or datasets of which tables and pictures are made."""

from __future__ import annotations

from abc import abstractmethod
from pathlib import Path

from stringcast.pipeline.console import bars
from stringcast.pipeline.experiment import Experiment, Mode
from stringcast.pipeline.modes.stepwise import needs_none
from stringcast.pipeline.result import Result
from stringcast.pipeline.terminal import Terminal
from stringcast.stages.common import Progress


class Study(Mode):
    """A mode that makes its own trials, row by row."""

    def check(self, experiment: Experiment) -> None:
        """As of `Mode`."""
        needs_none(experiment)

    @abstractmethod
    def run(self, experiment: Experiment, folder: Path, progress: Progress) -> str:
        """Leave tables and pictures in the folder; what came out, in a sentence."""

    def perform(self, experiment: Experiment, folder: Path, console: Terminal) -> Result:
        """As of `Mode`."""
        with bars(console) as bar, bar(experiment.config["name"]) as progress:
            sentence = self.run(experiment, folder, progress)
        console.print(sentence, soft_wrap=True, markup=False)
        return Result(folder, (), sentence)
