"""Say of each step of a run whether it is fresh or stale, and why."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stringcast.data.errors import printable
from stringcast.pipeline.commands.stored import NotMadeError, run_of, stored_experiment, walk
from stringcast.pipeline.experiment import Experiment
from stringcast.pipeline.iterations import Step
from stringcast.pipeline.registry import stages
from stringcast.pipeline.settings import UserError
from stringcast.pipeline.staleness import inputs, look, performed


def main(arguments: list[str]) -> int:
    """0 if all that was asked for is fresh, 1 if anything is stale or missing."""
    parser = argparse.ArgumentParser("python -m pipeline why", description=__doc__)
    parser.add_argument("place", type=Path, help="a run's folder, or that of one step: <run>/iterations/01/estimate")
    place = parser.parse_args(arguments).place
    folder = run_of(place)
    asked = place.resolve().relative_to(folder.resolve()).as_posix()
    states = [state for state in states_of(stored_experiment(folder), folder) if asked in (".", state.place)]
    if not states:
        known = ", ".join(sorted({stage.folder for stage in stages().values()}))
        raise UserError(f"{place}: the run has no such step. Name a folder iterations/<number>/<one of {known}>.")
    for state in states:
        print(printable("\n    ".join((f"{state.place}: {state.words}", *state.reasons))))
    return 1 if any(state.reasons for state in states) else 0


@dataclass(frozen=True)
class State:
    """A step's folder within its run, and why it is not fresh; no reasons if it is. stays: it is used all the same."""

    place: str
    reasons: tuple[str, ...]
    there: bool = True
    stays: bool = False

    @property
    def words(self) -> str:
        """Fresh, stale or missing."""
        if not self.there:
            return "missing"
        return "fresh" if not self.reasons else "stale, but stays: the arm has moved by it" if self.stays else "stale"


def states_of(here: Experiment, folder: Path) -> list[State]:
    """Of all steps of a run, in their order, up to the first that is missing."""
    states: dict[str, State] = {}

    def ask(step: Step) -> Any:
        place = step.place.as_posix()
        found = look(here.config, folder, step)
        above = [states[other] for other in inputs(folder, step) if other in states]
        doubt = [
            f"{state.place}, an input, is to be made again" for state in above if state.reasons and not state.stays
        ]
        stays = performed(here.config, folder, step)
        states[place] = State(place, (*found.reasons, *doubt), (folder / place).is_dir(), stays)
        if found.artifact is None:
            raise NotMadeError
        return found.artifact

    walk(here, folder, ask)
    return list(states.values())
