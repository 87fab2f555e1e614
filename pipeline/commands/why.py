"""Say of each step of a run whether it is fresh or stale, and why.

Files and settings are compared; no model is built.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from stringcast.data import store
from stringcast.data.schema import DataError
from stringcast.pipeline.commands import CommandParser, print_block
from stringcast.pipeline.commands.stored_runs import read_stored_settings, run_folder_of
from stringcast.pipeline.modes.stepwise import Stepwise
from stringcast.pipeline.run.file_names import SUMMARY_FILE, artifact_folder
from stringcast.pipeline.run.provenance import arm_has_executed, stale_reasons
from stringcast.pipeline.run.stage_graph import StageGraph
from stringcast.pipeline.settings.composition import UserError
from stringcast.pipeline.settings.named_plugins import use_stored_plugins
from stringcast.pipeline.settings.stage_registry import stages
from stringcast.pipeline.settings.typed_settings import build_chosen

StepState = tuple[str, tuple[str, ...]]  # state, and reasons if not fresh
FRESH_STEP: StepState = ("fresh", ())
MISSING_STEP: StepState = ("missing", ("it has not been made yet",))
STALE_STATE = "stale"
KEPT_STATE = "stale, but stays: the arm has moved by it"


def main(arguments: list[str]) -> int:
    """Print the state of each step; return 0 if all are fresh."""
    parser = CommandParser("python -m pipeline why", description=__doc__)
    parser.add_argument(
        "place",
        type=Path,
        help="a run's folder, or that of one step: <run>/iterations/01/estimate",
    )
    place: Path = parser.parse_args(arguments).place
    folder = run_folder_of(place)
    chosen = place.resolve().relative_to(folder.resolve()).as_posix()
    settings = read_stored_settings(folder)
    use_stored_plugins(settings, str(folder / "config.json"))
    try:
        mode = build_chosen(settings["mode"], "mode", "config.json")
        states = step_states(mode.graph(settings), settings, folder)
    except (KeyError, TypeError, AttributeError) as error:
        raise UserError(
            folder / "config.json",
            f"it does not hold the settings of a run ({error!r})",
            "Restore it; another version of this code may have made it.",
        ) from error
    names = [name for name in states if chosen in (".", name)]
    if not names and chosen == "." and isinstance(mode, Stepwise):
        raise UserError(
            folder,
            "the run has made no step yet",
            f"Continue it: python -m pipeline resume {shlex.quote(str(folder))}",
        )
    if not names:
        folders = ", ".join(sorted({stage.folder for stage in stages().values()}))
        raise UserError(
            place,
            "there is no such step; a study and a calibration have none",
            "Name the folder of another run, or of a step: "
            f"iterations/<number>/<one of {folders}>.",
        )
    for name in names:
        state, reasons = states[name]
        if state == FRESH_STEP[0] and store.images_not_kept(folder / name):
            state += "; its frames were not kept"
        print_block(f"{name}: {state}", reasons)
    return int(any(states[name] != FRESH_STEP for name in names))


def step_states(
    graph: StageGraph, settings: Mapping[str, Any], folder: Path
) -> dict[str, StepState]:
    """Return the state of each step of a run, by its folder within the run.

    A step with a stale input is stale. The next step of an unfinished cast is included
    as missing.
    """
    makers = {stages()[name].folder: name for name in graph.stages}
    order = [*makers]
    places = step_folders(folder)

    def position(name: str) -> tuple[int, int]:
        """Return iteration and place in it: inputs are made before."""
        place = places[name]
        stage = order.index(place.name) if place.name in order else len(order)
        return int(place.parent.name), stage

    states: dict[str, StepState] = {}
    for name in sorted(places, key=position):
        place = places[name]
        reasons = stale_reasons(folder, place, settings)
        for path in step_inputs(place):
            if states.get(path, FRESH_STEP)[0] == STALE_STATE:
                reasons += (f"{path}, an input, is stale",)
        states[name] = FRESH_STEP
        if reasons:
            number = int(place.parent.name)
            maker = makers.get(place.name, place.name)
            has_moved = arm_has_executed(settings, folder, number, maker, graph)
            states[name] = KEPT_STATE if has_moved else STALE_STATE, reasons

    numbers = [int(place.parent.name) for place in places.values()]
    last = max(numbers, default=1)
    missing = missing_step(settings, folder, last)
    if missing is not None:
        states[missing.as_posix()] = MISSING_STEP
    return states


def step_folders(folder: Path) -> dict[str, Path]:
    """Return the folders of the steps of a run, by their paths within it."""
    known = {stage.folder for stage in stages().values()}
    places = {}
    for place in sorted(folder.glob("iterations/*/*")):
        is_step = place.name in known and place.parent.name.isdecimal()
        if is_step and place.is_dir():
            places[place.relative_to(folder).as_posix()] = place
    return places


def step_inputs(place: Path) -> list[str]:
    """Return the inputs of a step, from the footers of its tables."""
    try:
        return [*store.read_origin(place).get("inputs", {})]
    except (DataError, *store.READ_ERRORS):
        return []


def missing_step(settings: Mapping[str, Any], folder: Path, number: int) -> Path | None:
    """Return the first missing step in an iteration of an unfinished run."""
    if (folder / SUMMARY_FILE).exists():
        return None
    for name in settings["mode"].get("stages", ()):
        if name in stages():
            step_folder = artifact_folder(number, stages()[name].folder)
            if not (folder / step_folder).is_dir():
                return step_folder
    return None
