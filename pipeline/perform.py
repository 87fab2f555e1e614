"""One run from its settings to its report, on the terminal and in its folder."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from pipeline import report
from pipeline.run import Result, begin, cast, diagnose, estimate_again
from pipeline.show import bars, summary
from pipeline.study import command as study
from pipeline.world import World


def perform(here: World, folder: Path, console: Console) -> Result:
    """Run and report; what is in `folder` already is not made again."""
    if here.config["steps"] == ["study"]:
        return blind_study(here, folder, console)
    trials = here.config["trials"]
    with bars(console) as bar:
        if "diagnose" in here.config["steps"]:
            result = diagnose(here, folder, Path(trials), bar)
        elif trials is not None:
            result = estimate_again(here, folder, Path(trials), bar)
        else:
            result = cast(here, folder, bar)
        with bar("report"):
            report.write(here, result)
    console.print(summary(result))
    return result


def blind_study(here: World, folder: Path, console: Console) -> Result:
    """Its scores on the terminal, its tables and pictures in the folder."""
    begin(here, folder)
    with bars(console) as bar, bar("blind study") as progress:
        sentence = study.run(here, folder, progress)
    console.print(sentence, soft_wrap=True)
    return Result(folder, (), sentence)
