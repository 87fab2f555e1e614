"""One run from its settings to its report, on the terminal and in its folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from rich.console import Console
from rich.markup import escape

from pipeline import keep, report
from pipeline.hitting import study as hit_study
from pipeline.run import Result, work
from pipeline.show import bars, summary
from pipeline.study import command as blind_study
from pipeline.world import World

Study = Callable[[World, Path, Callable[[float], object]], str]
STUDIES: dict[str, Study] = {"study": blind_study.run, "hit_study": hit_study.run}


def perform(here: World, folder: Path, console: Console) -> Result:
    """Run and report; what is in `folder` already is not made again."""
    with keep.alone(folder):
        keep.begin(here, folder)
        with keep.failing(folder):
            if here.config["steps"][0] in STUDIES:
                return studied(here, folder, console, STUDIES[here.config["steps"][0]])
            return cast_or_look_again(here, folder, console)


def cast_or_look_again(here: World, folder: Path, console: Console) -> Result:
    """All but a study. The report comes before run.json, which says that all is there."""
    with bars(console) as bar:
        result = work(here, folder, keep.Keeper(here, folder, bar, lambda words: console.print(escape(words))))
        with bar("report"):
            report.write(here, result)
        keep.end(result)
    console.print(summary(result))
    return result


def studied(here: World, folder: Path, console: Console, run: Study) -> Result:
    """A study: its scores on the terminal, its tables and pictures in the folder."""
    with bars(console) as bar, bar("study") as progress:
        sentence = run(here, folder, progress)
    console.print(sentence, soft_wrap=True)
    return Result(folder, (), sentence)
