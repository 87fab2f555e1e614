"""Provenance of stored runs: the commands verify, why, diff and lineage."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from graphlib import TopologicalSorter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rich.text import Text
from rich.tree import Tree

from stringcast.data import store
from stringcast.data.compare import differences, differing_files
from stringcast.data.errors import printable
from stringcast.data.foreign import json_block
from stringcast.data.schema import DataError
from stringcast.pipeline import run_folder
from stringcast.pipeline.commands import paths
from stringcast.pipeline.commands.stored import NotMadeError, run_of, stored_experiment, stored_settings, walk
from stringcast.pipeline.console import bars
from stringcast.pipeline.experiment import Experiment
from stringcast.pipeline.iterations import Step
from stringcast.pipeline.layout import ENDED, FAILED, LOG, place_of
from stringcast.pipeline.provenance import look, pairs, performed, reasons_of, repeatable
from stringcast.pipeline.registry import stages
from stringcast.pipeline.result import Result, in_numbers
from stringcast.pipeline.settings import UserError, leaves
from stringcast.pipeline.terminal import Terminal

DRAWN = frozenset({"config.json", ENDED, FAILED, LOG, "report.html"})  # compared by another heading, or drawn
FRESH, STALE, KEPT, MISSING = "fresh", "stale", "stale, but stays: the arm has moved by it", "missing"  # of a step


def _say(heading: str, words: list[str] | tuple[str, ...]) -> None:
    print(printable("\n    ".join((heading, *words))))


# --- verify -----------------------------------------------------------------------------------
def verify(arguments: list[str]) -> int:
    """Compute every step of a run again from what is on the disk, and compare to the bit."""
    (folder,) = paths(verify, arguments, run="the run's folder; nothing is written into it")
    here = stored_experiment(folder)
    with bars(Terminal(stderr=True)) as bar, TemporaryDirectory() as aside:
        outcome = verified(here, folder, Path(aside), bar)
    for line in outcome.lines:
        print(printable(line))
    return 0 if outcome.same else 1


@dataclass
class Comparison:
    """same: no step is missing, and none came out otherwise. lines: step by step, in words."""

    same: bool = True
    lines: list[str] = field(default_factory=list)

    def note(self, what: str, faults: list[str], good: str = "the same to the bit") -> None:
        """Note the outcome of one comparison."""
        self.same = self.same and not faults
        self.lines += [f"{what}: {'DIFFERS' if faults else good}", *(f"    {fault}" for fault in faults)]


def verified(
    here: Experiment, folder: Path, aside: Path, bar: Callable[[str], AbstractContextManager[Any]]
) -> Comparison:
    """Every step, then what the run wrote from them. aside: an empty folder to compute in."""
    outcome = Comparison()

    def ask(step: Step) -> Any:
        found, place = look(here.config, folder, step), step.place.as_posix()
        if found.artifact is None:
            outcome.note(place, list(found.reasons))
            raise NotMadeError
        if not repeatable(here.config, step.stage.folder):
            outcome.note(place, [], "measured with a real arm and camera, cannot be computed again")
            return found.artifact
        with bar(f"{step.number}. {step.stage.name}") as progress:
            store.save(here.run(step, progress), aside / step.place, {})
        faults = differing_files(folder / step.place, aside / step.place)
        outcome.note(place, [*faults, *(f"since it was made: {reason}" for reason in found.reasons if faults)])
        return found.artifact

    result = walk(here, folder, ask)
    if result is not None:
        _ending(here, folder, aside, result, outcome)
    return outcome


def _ending(here: Experiment, folder: Path, aside: Path, result: Result, outcome: Comparison) -> None:
    """The dataset and run.json: drawn from the steps alone, they must say what these say."""
    iterations = [i for i in result.iterations if {"trial", "points"} <= i.done.keys()]
    if here.config["trials"] is None and iterations:
        run_folder.publish(here, run_folder.trial_hashes(folder, iterations), aside, iterations)
        written = [*sorted(aside.glob("*.parquet")), aside / "dataset.yaml"]
        faults = [f"{path.name}: {words}" for path in written for words in differences(folder / path.name, path)]
        outcome.note("the run as a dataset", faults)
    path = folder / ENDED
    if not path.is_file():
        outcome.note(ENDED, ["it is missing: the run has not ended; `resume` ends it"])
        return
    same = json.loads(path.read_text(encoding="utf-8")) == json.loads(json.dumps(in_numbers(result)))
    outcome.note(ENDED, [] if same else ["it says something else than the steps"])


# --- why ----------------------------------------------------------------------------------------
def why(arguments: list[str]) -> int:
    """Say of each step of a run whether it is fresh or stale, and why, by its files and settings: nothing is built."""
    (place,) = paths(why, arguments, place="a run's folder, or that of one step: <run>/iterations/01/estimate")
    folder = run_of(place)
    asked = place.resolve().relative_to(folder.resolve()).as_posix()
    states = states_of(stored_settings(folder), folder)
    shown = {name: states[name] for name in sorted(states, key=lambda name: Path(name).parent) if asked in (".", name)}
    if not shown:
        known = ", ".join(sorted({stage.folder for stage in stages().values()}))
        raise UserError(
            f"{place}: there is no such step; a study and a calibration have none. Name the folder of another run, or "
            f"of a step: iterations/<number>/<one of {known}>."
        )
    for name, (state, reasons) in shown.items():
        _say(f"{name}: {state}", reasons)
    return 1 if any(reasons for _, reasons in shown.values()) else 0


def states_of(settings: Mapping[str, Any], folder: Path) -> dict[str, tuple[str, tuple[str, ...]]]:
    """FRESH, STALE, KEPT or MISSING, and why, of each step of a run after its inputs, and of the step that an
    unfinished cast lacks next; by their folders within the run. settings: the run's."""
    known = {stage.folder for stage in stages().values()}
    places = sorted(place for place in folder.glob("iterations/*/*") if place.is_dir() and place.name in known)
    names = {place.relative_to(folder).as_posix(): place for place in places}
    inputs: dict[str, list[str]] = {}  # as their footers have them; none where a footer cannot be read
    for name, place in names.items():
        try:
            inputs[name] = [one for one in store.origin_of(place).get("inputs", {}) if one in names]
        except (DataError, *store.UNREADABLE):
            inputs[name] = []
    states: dict[str, tuple[str, tuple[str, ...]]] = {}
    for name in TopologicalSorter(inputs).static_order():
        stale = (f"{one}, an input, is stale" for one in inputs[name] if states[one][0] == STALE)
        reasons = (*reasons_of(folder, names[name], settings), *stale)
        moved = performed(settings, folder, int(names[name].parent.name), names[name].name)
        states[name] = FRESH if not reasons else KEPT if moved else STALE, reasons
    last = max(len({place.parent for place in places}), 1)
    needed = [stages()[name].folder for name in settings["mode"].get("stages", ()) if name in stages()]
    lacking = [place for name in needed if not (folder / (place := place_of(last, name))).is_dir()]
    if lacking and not (folder / ENDED).exists():
        states[lacking[0].as_posix()] = MISSING, ("it has not been made yet",)
    return states


# --- diff ---------------------------------------------------------------------------------------
def diff(arguments: list[str]) -> int:
    """Say what differs between two runs: settings, data, code, packages, results."""
    a, b = paths(diff, arguments, a="a run's folder", b="another's")
    one, other = facts(a), facts(b)
    found = {what: [f"{name}: {x} and {y}" for name, x, y in pairs(one[what], other[what])] for what in one}
    found["results"] += differing_files(a, b, DRAWN)
    for what, differing in found.items():
        _say(f"{what}: {'differ' if differing else 'the same'}", differing)
    return 1 if any(found.values()) else 0


def facts(run: Path) -> dict[str, dict[str, Any]]:
    """The parts of a run that `diff` compares, by name: settings, data, code, packages, results. Raises UserError where
    there is no run, DataError where it has made nothing."""
    path, ended = run / "config.json", run / ENDED
    if not path.is_file():
        raise UserError(f"{run}: there is no run here (it has no config.json). Name a run's folder.")
    origins = [made for file in sorted(run.rglob("*.parquet")) if "code" in (made := store.origin_of(file))]
    if not origins:
        raise DataError(f"{run}: the run has made nothing yet. `python -m pipeline resume {run}` goes on with it.")
    numbers: dict[str, Any] = json_block(ended) if ended.exists() else {"ended": False, "iterations": []}
    numbers |= {"iterations": {str(row["number"]): row for row in numbers["iterations"]}}
    inputs = {name: digest for made in origins for name, digest in made["inputs"].items()}
    outside = {name: digest for name, digest in inputs.items() if not name.startswith("iterations/")}
    first = origins[0]
    used = {name: digest for made in origins for name, digest in made.get("sources", {}).items()}
    return {
        "settings": leaves(json_block(path)),
        "data": {Path(name).name: f"content {digest[:8]}" for name, digest in outside.items()},
        "code": {"commit": first["code"]["commit"], "all sources": first["code"]["source"][:8]} | used,
        "packages": first["packages"] | {"Python": first["python"]},
        "results": {f"run.json: {name}": value for name, value in leaves(numbers).items()},
    }


# --- lineage --------------------------------------------------------------------------------------
def lineage(arguments: list[str]) -> int:
    """Show what made a file: back through its inputs to settings, seed, code and packages."""
    (file,) = paths(lineage, arguments, file="a file of a run, or a step's folder")
    tree = Tree(Text(str(file)))
    changed = _grow(tree, file.resolve(), run_of(file), set())
    Terminal(highlight=False).print(tree)
    return 1 if changed else 0


def _grow(tree: Tree, place: Path, run: Path, shown: set[Path | str]) -> bool:
    """Add the origin of `place`, in the folder of `run`, to a tree, and the origins of its inputs; whether one of these
    is not as it was. shown: places and lines, which are not shown twice."""
    made = {} if place in shown else _made(place, run)
    words = [line for line in _words(made) if line not in shown] if made else []
    for line in words:
        tree.add(Text(line))
    shown |= {place, *words}
    changed = False
    for name, digest in made.get("inputs", {}).items():
        there = next((path.resolve() for path in (run / name, Path(name)) if path.exists()), None)
        state = " IS GONE"
        if there is not None:
            try:
                state = "" if store.content_hash(there) == digest else " HAS CHANGED SINCE"
            except store.UNREADABLE:
                state = " IS DAMAGED"
        branch = tree.add(Text(f"{name}{state}{' (see above)' if there in shown else ''}"))
        changed |= bool(state)
        if there is not None:
            home = next((up for up in (there, *there.parents) if (up / "config.json").is_file()), run)
            changed |= _grow(branch, there, home, shown)
    return changed


def _made(place: Path, run: Path) -> dict[str, Any]:
    """The origin of a file or a step's folder; empty for what is not ours.

    A file without a footer was drawn from the steps of its folder: a frame from its trial, a report from the last step.
    """
    if place.suffix == ".parquet":
        files = [place]
    elif run in (place.parent, place):
        files = sorted(run.glob("iterations/*/*/*.parquet"))[-1:]
    else:
        files = next((found for up in (place, *place.parents) if (found := sorted(up.glob("*.parquet")))), [])[:1]
    made = store.origin_of(files[0]) if files else {}
    return made if "inputs" in made else {}


def _words(made: Mapping[str, Any]) -> list[str]:
    """Step, seed, the step's own settings, code and packages, a line each."""
    step = made["step"]
    own = leaves({key: made["config"][key] for key in (step, "seed") if key in made["config"]})
    others = [name for name in stages()[step].uses if name not in (step, "seed")] if step in stages() else []
    when = f", {made['made']['at']}, {made['made']['seconds']:.1f} s" if "made" in made else ""
    settings = ", ".join(f"{name}={value}" for name, value in own.items())
    packages = ", ".join(f"{name} {value}" for name, value in made["packages"].items())
    return [
        f"made by {step}, seed {made['seed']}{when}",
        f"settings {settings}; and {', '.join(others)} of config.json",
        f"code: commit {made['code']['commit'][:12]}, source {made['code']['source'][:12]}",
        f"packages: {packages}, Python {made['python']}",
    ]
