"""One run from its settings to its report, on the terminal and in its folder."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.markup import escape

from pipeline import keep, report
from pipeline.run import Result, work
from pipeline.show import bars, summary
from pipeline.study import command as study
from pipeline.world import World


def perform(here: World, folder: Path, console: Console) -> Result:
    """Run and report; what is in `folder` already is not made again."""
    with keep.alone(folder):
        keep.begin(here, folder)
        with keep.failing(folder):
            if here.config["steps"] == ["study"]:
                return blind_study(here, folder, console)
            return cast_or_look_again(here, folder, console)


def cast_or_look_again(here: World, folder: Path, console: Console) -> Result:
    """All but a study. The report comes before run.json, which says that all is there."""
    with bars(console) as bar:
        result = work(here, folder, keep.Keeper(here, folder, bar, lambda words: console.print(escape(words))))
        if "report" in here.config["leave"]:
            with bar("report"):
                report.write(here, result)
        keep.end(result)
    if "frames" not in here.config["leave"]:
        keep.without_frames(here, result)
    console.print(summary(result))
    return result


def blind_study(here: World, folder: Path, console: Console) -> Result:
    """Its scores on the terminal, its tables and pictures in the folder."""
    with bars(console) as bar, bar("blind study") as progress:
        sentence = study.run(here, folder, progress)
    console.print(sentence, soft_wrap=True)
    return Result(folder, (), sentence)
