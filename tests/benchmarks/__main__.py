"""Run a study or a benchmark command: `python3 tasks.py study NAME [ARGUMENTS]`.

Studies take settings as Hydra overrides, and `folder=` for their results:
diagnosis, extraction, casting, learning, gain, adaptive, worlds, forecast, practice, measured, clocks.
Commands take arguments of their own (see --help): draw, alignment, footage, strings.
"""

from __future__ import annotations

import os
import sys
from importlib import import_module
from pathlib import Path

from hydra.errors import HydraException

from stringcast.data.errors import ExpectedError
from stringcast.pipeline.cli.console import progress_bar
from stringcast.pipeline.cli.terminal import Terminal
from tests.benchmarks.study import Study, run_study, study_settings

STUDIES = {
    "diagnosis": "diagnosis.study.DiagnosisStudy",
    "extraction": "extraction.study.ExtractionStudy",
    "casting": "casting.study.CastingStudy",
    "learning": "casting.study.CastingStudy",
    "gain": "casting.study.CastingStudy",
    "adaptive": "casting.study.CastingStudy",
    "worlds": "casting.study.CastingStudy",
    "forecast": "casting.study.CastingStudy",
    "practice": "casting.study.CastingStudy",
    "measured": "measured.study.MeasuredStudy",
    "clocks": "clocks.study.ClocksStudy",
}
COMMANDS = {
    "draw": "draw",
    "alignment": "alignment.errors",
    "footage": "extraction.footage",
    "strings": "measured.strings",
}


def main(words: list[str]) -> int:
    """Dispatch to a study or a command; return the exit status."""
    name, arguments = (words[0], words[1:]) if words else ("", [])
    os.environ["HYDRA_FULL_ERROR"] = "1"
    try:
        if name in COMMANDS:
            return (
                import_module(f"tests.benchmarks.{COMMANDS[name]}").main(arguments) or 0
            )
        if name in STUDIES:
            run(name, arguments)
            return 0
    except (ExpectedError, HydraException) as error:
        print(f"Error: {error}", file=sys.stderr)
        return 1
    print(__doc__)
    return 2


def run(name: str, overrides: list[str]) -> None:
    """Run a study in its folder and print its summary."""
    module, _, kind = STUDIES[name].rpartition(".")
    study: Study = getattr(import_module(f"tests.benchmarks.{module}"), kind)()
    config = study_settings(name, overrides)
    console = Terminal(stderr=True)
    with progress_bar(name, console) as progress:
        summary = run_study(study, config, Path(config["folder"]), progress)
    console.print(summary, soft_wrap=True, markup=False)
    console.print(config["folder"], soft_wrap=True, markup=False)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
