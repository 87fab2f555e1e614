"""Say of each step of a run whether it is fresh or stale, and why, by its files and settings: nothing is built."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stringcast.data import store
from stringcast.data.errors import printable
from stringcast.data.schema import DataError
from stringcast.pipeline.commands.stored import run_of, stored_settings
from stringcast.pipeline.layout import ENDED, place_of
from stringcast.pipeline.registry import stages
from stringcast.pipeline.settings import UserError
from stringcast.pipeline.staleness import performed, reasons_of
from stringcast.stages.spec import This


def main(arguments: list[str]) -> int:
    """0 if all that was asked for is fresh, 1 if anything is stale or missing."""
    parser = argparse.ArgumentParser("python -m pipeline why", description=__doc__)
    parser.add_argument("place", type=Path, help="a run's folder, or that of one step: <run>/iterations/01/estimate")
    place = parser.parse_args(arguments).place
    folder = run_of(place)
    asked = place.resolve().relative_to(folder.resolve()).as_posix()
    states = [state for state in states_of(stored_settings(folder), folder) if asked in (".", state.place)]
    if not states:
        known = ", ".join(sorted({stage.folder for stage in stages().values()}))
        raise UserError(
            f"{place}: there is no such step; a study and a calibration have none. Name the folder of another run, or "
            f"of a step: iterations/<number>/<one of {known}>."
        )
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


def states_of(settings: Mapping[str, Any], folder: Path) -> list[State]:
    """Of all steps of a run, iteration by iteration, and what an unfinished one lacks next. settings: the run's."""
    states: dict[str, State] = {}
    places = _steps(folder)
    for place in places:
        name = place.relative_to(folder).as_posix()
        above = [states[other] for other in _inputs(place) if other in states]
        doubt = (f"{one.place}, an input, is to be made again" for one in above if one.reasons and not one.stays)
        stays = performed(settings, folder, int(place.parent.name), place.name)
        states[name] = State(name, (*reasons_of(folder, place, settings), *doubt), stays=stays)
    return [*states.values(), *_missing(settings, folder, len({place.parent for place in places}))]


def _steps(folder: Path) -> list[Path]:
    """Folders of a run's steps, what a stage looks at before it."""
    known = {stage.folder for stage in stages().values()}
    there = (place for place in folder.glob("iterations/*/*") if place.is_dir() and place.name in known)
    return sorted(there, key=lambda place: (place.parent.name, _depth(place.name), place.name))


def _depth(artifact: str) -> int:
    """How many stages of an iteration follow one another up to this artifact. Trials are read in points."""
    asked = {
        "points" if name == "trials" else name
        for stage in stages().values()
        if stage.folder == artifact
        for name, given in stage.inputs.items()
        if isinstance(given, This)
    }
    return 1 + max(map(_depth, asked), default=-1)


def _inputs(place: Path) -> list[str]:
    """What a step was made of, as far as that can be read: folders within its run."""
    try:
        return list(store.origin_of(sorted(place.glob("*.parquet"))[0])["inputs"])
    except (DataError, LookupError, *store.UNREADABLE):
        return []


def _missing(settings: Mapping[str, Any], folder: Path, iterations: int) -> Iterator[State]:
    """The first step of its last iteration that an unfinished cast lacks."""
    names = settings["mode"].get("stages", ())
    places = [place_of(max(iterations, 1), stages()[name].folder) for name in names if name in stages()]
    lacking = [place for place in places if not (folder / place).is_dir()]
    if lacking and not (folder / ENDED).exists():
        yield State(lacking[0].as_posix(), ("it has not been made yet",), there=False)
