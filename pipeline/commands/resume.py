"""Go on with a run that was interrupted, or that failed, with its own settings."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.console import Console

from data import dataset
from pipeline.perform import perform
from pipeline.settings import UserError
from pipeline.world import World, world


def main(arguments: list[str]) -> int:
    """Go on; the exit status."""
    parser = argparse.ArgumentParser("python -m pipeline resume", description=__doc__)
    parser.add_argument("run", type=Path, help="the run's folder")
    folder = parser.parse_args(arguments).run
    perform(stored_world(folder), folder, Console(stderr=True))
    return 0


def stored_world(folder: Path) -> World:
    """What a run works with, from its config.json. Raises UserError where there is none."""
    path = folder / "config.json"
    if not path.is_file():
        raise UserError(f"{folder}: there is no run here (it has no config.json). Name a run's folder.")
    return world(dataset.settings(path), lambda block: str(path))
