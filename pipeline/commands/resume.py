"""Go on with a run that was interrupted or failed, with its own settings."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.console import Console

from pipeline.commands.stored import stored_world
from pipeline.perform import perform


def main(arguments: list[str]) -> int:
    """Go on; 0 when the run has ended."""
    parser = argparse.ArgumentParser("python -m pipeline resume", description=__doc__)
    parser.add_argument("run", type=Path, help="the run's folder")
    folder = parser.parse_args(arguments).run
    perform(stored_world(folder), folder, Console(stderr=True))
    return 0
