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
from stringcast.data.compare import file_differences, folder_differences
from stringcast.data.errors import escape_control_characters
from stringcast.data.file_checks import read_json
from stringcast.data.schema import DataError
from stringcast.pipeline.cli.console import progress_bars
from stringcast.pipeline.cli.terminal import Terminal
from stringcast.pipeline.commands import parse_paths
from stringcast.pipeline.commands.stored_runs import (
    NotMadeError,
    read_stored_experiment,
    read_stored_settings,
    run_folder_of,
    walk_steps,
)
from stringcast.pipeline.run import run_folder
from stringcast.pipeline.run.experiment import Experiment
from stringcast.pipeline.run.file_names import (
    FAILURE_FILE,
    LOG_FILE,
    SUMMARY_FILE,
    artifact_folder,
)
from stringcast.pipeline.run.iterations import Step
from stringcast.pipeline.run.provenance import (
    arm_has_executed,
    differing_values,
    is_repeatable,
    load_step_with_staleness,
    stale_reasons,
)
from stringcast.pipeline.run.result import RunResult, run_summary
from stringcast.pipeline.settings.composition import UserError, flatten_settings
from stringcast.pipeline.settings.stage_registry import stages

# compared by another heading, or drawn
UNCOMPARED_FILES = frozenset(
    {"config.json", SUMMARY_FILE, FAILURE_FILE, LOG_FILE, "report.html"}
)
# of a step
FRESH_STATE, STALE_STATE, KEPT_STATE, MISSING_STATE = (
    "fresh",
    "stale",
    "stale, but stays: the arm has moved by it",
    "missing",
)


def print_block(heading: str, words: list[str] | tuple[str, ...]) -> None:
    print(escape_control_characters("\n    ".join((heading, *words))))


# --- verify
# -----------------------------------------------------------------------------------
def verify(arguments: list[str]) -> int:
    """Compute every step of a run again from what is on the disk, and compare to the
    bit.
    """
    (folder,) = parse_paths(
        verify, arguments, run="the run's folder; nothing is written into it"
    )
    here = read_stored_experiment(folder)
    with progress_bars(Terminal(stderr=True)) as bar, TemporaryDirectory() as aside:
        outcome = verify_run(here, folder, Path(aside), bar)
    for line in outcome.lines:
        print(escape_control_characters(line))
    return 0 if outcome.is_same else 1


@dataclass
class Comparison:
    """same: no step is missing, and none came out otherwise. lines: step by step, in
    words.
    """

    is_same: bool = True
    lines: list[str] = field(default_factory=list)

    def note(
        self, what: str, faults: list[str], good: str = "the same to the bit"
    ) -> None:
        """Note the outcome of one comparison."""
        self.is_same = self.is_same and not faults
        self.lines += [
            f"{what}: {'DIFFERS' if faults else good}",
            *(f"    {fault}" for fault in faults),
        ]


def verify_run(
    here: Experiment,
    folder: Path,
    aside: Path,
    bar: Callable[[str], AbstractContextManager[Any]],
) -> Comparison:
    """Every step, then what the run wrote from them. aside: an empty folder to compute
    in.
    """
    outcome = Comparison()

    def ask(step: Step) -> Any:
        found, place = (
            load_step_with_staleness(here.config, folder, step),
            step.folder.as_posix(),
        )
        if found.artifact is None:
            outcome.note(place, list(found.stale_reasons))
            raise NotMadeError
        if not is_repeatable(here.config, step.stage.folder):
            outcome.note(
                place,
                [],
                "measured with a real arm and camera, cannot be computed again",
            )
            return found.artifact
        with bar(f"{step.number}. {step.stage.name}") as progress:
            store.save(here.run_step(step, progress), aside / step.folder, {})
        faults = folder_differences(folder / step.folder, aside / step.folder)
        outcome.note(
            place,
            [
                *faults,
                *(
                    f"since it was made: {reason}"
                    for reason in found.stale_reasons
                    if faults
                ),
            ],
        )
        return found.artifact

    result = walk_steps(here, folder, ask)
    if result is not None:
        compare_run_files(here, folder, aside, result, outcome)
    return outcome


def compare_run_files(
    here: Experiment, folder: Path, aside: Path, result: RunResult, outcome: Comparison
) -> None:
    """The dataset and run.json: drawn from the steps alone, they must say what these
    say.
    """
    iterations = [
        i for i in result.iterations if {"trial", "points"} <= i.artifacts.keys()
    ]
    if here.config["trials"] is None and iterations:
        run_folder.publish_dataset(
            here, run_folder.trial_hashes(folder, iterations), aside, iterations
        )
        written = [*sorted(aside.glob("*.parquet")), aside / "dataset.yaml"]
        faults = [
            f"{path.name}: {words}"
            for path in written
            for words in file_differences(folder / path.name, path)
        ]
        outcome.note("the run as a dataset", faults)
    path = folder / SUMMARY_FILE
    if not path.is_file():
        outcome.note(
            SUMMARY_FILE, ["it is missing: the run has not ended; `resume` ends it"]
        )
        return
    same = json.loads(path.read_text(encoding="utf-8")) == json.loads(
        json.dumps(run_summary(result))
    )
    outcome.note(
        SUMMARY_FILE, [] if same else ["it says something else than the steps"]
    )


# --- why
# ----------------------------------------------------------------------------------------
def why(arguments: list[str]) -> int:
    """Say of each step of a run whether it is fresh or stale, and why, by its files and
    settings: nothing is built.
    """
    (place,) = parse_paths(
        why,
        arguments,
        place="a run's folder, or that of one step: <run>/iterations/01/estimate",
    )
    folder = run_folder_of(place)
    asked = place.resolve().relative_to(folder.resolve()).as_posix()
    states = step_states(read_stored_settings(folder), folder)
    shown = {
        name: states[name]
        for name in sorted(states, key=lambda name: Path(name).parent)
        if asked in (".", name)
    }
    if not shown:
        known = ", ".join(sorted({stage.folder for stage in stages().values()}))
        raise UserError(
            f"{place}: there is no such step; a study and a calibration have none. Name the folder of another run, or "
            f"of a step: iterations/<number>/<one of {known}>."
        )
    for name, (state, reasons) in shown.items():
        print_block(f"{name}: {state}", reasons)
    return 1 if any(reasons for _, reasons in shown.values()) else 0


def step_states(
    settings: Mapping[str, Any], folder: Path
) -> dict[str, tuple[str, tuple[str, ...]]]:
    """FRESH, STALE, KEPT or MISSING, and why, of each step of a run after its inputs,
    and of the step that an unfinished cast lacks next; by their folders within the run.
    settings: the run's.
    """
    known = {stage.folder for stage in stages().values()}
    places = sorted(
        place
        for place in folder.glob("iterations/*/*")
        if place.is_dir() and place.name in known
    )
    names = {place.relative_to(folder).as_posix(): place for place in places}
    # as their footers have them; none where a footer cannot be read
    inputs: dict[str, list[str]] = {}
    for name, place in names.items():
        try:
            inputs[name] = [
                one
                for one in store.read_origin(place).get("inputs", {})
                if one in names
            ]
        except (DataError, *store.READ_ERRORS):
            inputs[name] = []
    states: dict[str, tuple[str, tuple[str, ...]]] = {}
    for name in TopologicalSorter(inputs).static_order():
        stale = (
            f"{one}, an input, is stale"
            for one in inputs[name]
            if states[one][0] == STALE_STATE
        )
        reasons = (*stale_reasons(folder, names[name], settings), *stale)
        moved = arm_has_executed(
            settings, folder, int(names[name].parent.name), names[name].name
        )
        states[name] = (
            FRESH_STATE if not reasons else KEPT_STATE if moved else STALE_STATE,
            reasons,
        )
    last = max(len({place.parent for place in places}), 1)
    needed = [
        stages()[name].folder
        for name in settings["mode"].get("stages", ())
        if name in stages()
    ]
    lacking = [
        place
        for name in needed
        if not (folder / (place := artifact_folder(last, name))).is_dir()
    ]
    if lacking and not (folder / SUMMARY_FILE).exists():
        states[lacking[0].as_posix()] = MISSING_STATE, ("it has not been made yet",)
    return states


# --- diff
# ---------------------------------------------------------------------------------------
def diff(arguments: list[str]) -> int:
    """Say what differs between two runs: settings, data, code, packages, results."""
    a, b = parse_paths(diff, arguments, a="a run's folder", b="another's")
    one, other = run_facts(a), run_facts(b)
    found = {
        what: [
            f"{name}: {x} and {y}"
            for name, x, y in differing_values(one[what], other[what])
        ]
        for what in one
    }
    found["results"] += folder_differences(a, b, UNCOMPARED_FILES)
    for what, differing in found.items():
        print_block(f"{what}: {'differ' if differing else 'the same'}", differing)
    return 1 if any(found.values()) else 0


def run_facts(run: Path) -> dict[str, dict[str, Any]]:
    """The parts of a run that `diff` compares, by name: settings, data, code, packages,
    results. Raises UserError where there is no run, DataError where it has made
    nothing.
    """
    path, ended = run / "config.json", run / SUMMARY_FILE
    if not path.is_file():
        raise UserError(
            f"{run}: there is no run here (it has no config.json). Name a run's folder."
        )
    origins = [
        made
        for file in sorted(run.rglob("*.parquet"))
        if "code" in (made := store.read_origin(file))
    ]
    if not origins:
        raise DataError(
            f"{run}: the run has made nothing yet. `python -m pipeline resume {run}` goes on with it."
        )
    numbers: dict[str, Any] = (
        read_json(ended) if ended.exists() else {"ended": False, "iterations": []}
    )
    numbers |= {
        "iterations": {str(row["number"]): row for row in numbers["iterations"]}
    }
    inputs = {
        name: digest for made in origins for name, digest in made["inputs"].items()
    }
    outside = {
        name: digest
        for name, digest in inputs.items()
        if not name.startswith("iterations/")
    }
    first = origins[0]
    used = {
        name: digest
        for made in origins
        for name, digest in made.get("sources", {}).items()
    }
    return {
        "settings": flatten_settings(read_json(path)),
        "data": {
            Path(name).name: f"content {digest[:8]}" for name, digest in outside.items()
        },
        "code": {
            "commit": first["code"]["commit"],
            "all sources": first["code"]["source"][:8],
        }
        | used,
        "packages": first["packages"] | {"Python": first["python"]},
        "results": {
            f"run.json: {name}": value
            for name, value in flatten_settings(numbers).items()
        },
    }


# --- lineage
# --------------------------------------------------------------------------------------
def lineage(arguments: list[str]) -> int:
    """Show what made a file: back through its inputs to settings, seed, code and
    packages.
    """
    (file,) = parse_paths(
        lineage, arguments, file="a file of a run, or a step's folder"
    )
    tree = Tree(Text(str(file)))
    changed = add_origin(tree, file.resolve(), run_folder_of(file), set())
    Terminal(highlight=False).print(tree)
    return 1 if changed else 0


def add_origin(tree: Tree, place: Path, run: Path, shown: set[Path | str]) -> bool:
    """Add the origin of `place`, in the folder of `run`, to a tree, and the origins of
    its inputs; whether one of these is not as it was. shown: places and lines, which
    are not shown twice.
    """
    made = {} if place in shown else origin_of_file(place, run)
    words = (
        [line for line in describe_origin(made) if line not in shown] if made else []
    )
    for line in words:
        tree.add(Text(line))
    shown |= {place, *words}
    changed = False
    for name, digest in made.get("inputs", {}).items():
        there = next(
            (path.resolve() for path in (run / name, Path(name)) if path.exists()), None
        )
        state = " IS GONE"
        if there is not None:
            try:
                state = (
                    "" if store.content_hash(there) == digest else " HAS CHANGED SINCE"
                )
            except store.READ_ERRORS:
                state = " IS DAMAGED"
        branch = tree.add(
            Text(f"{name}{state}{' (see above)' if there in shown else ''}")
        )
        changed |= bool(state)
        if there is not None:
            home = next(
                (
                    up
                    for up in (there, *there.parents)
                    if (up / "config.json").is_file()
                ),
                run,
            )
            changed |= add_origin(branch, there, home, shown)
    return changed


def origin_of_file(place: Path, run: Path) -> dict[str, Any]:
    """The origin of a file or a step's folder; empty for what is not ours.

    A file without a footer was drawn from the steps of its folder: a frame from its
    trial, a report from the last step.
    """
    if place.suffix == ".parquet":
        files = [place]
    elif run in (place.parent, place):
        files = sorted(run.glob("iterations/*/*/*.parquet"))[-1:]
    else:
        files = next(
            (
                found
                for up in (place, *place.parents)
                if (found := sorted(up.glob("*.parquet")))
            ),
            [],
        )[:1]
    made = store.read_origin(files[0]) if files else {}
    return made if "inputs" in made else {}


def describe_origin(made: Mapping[str, Any]) -> list[str]:
    """Step, seed, the step's own settings, code and packages, a line each."""
    step = made["step"]
    own = flatten_settings(
        {key: made["config"][key] for key in (step, "seed") if key in made["config"]}
    )
    others = (
        [name for name in stages()[step].uses if name not in (step, "seed")]
        if step in stages()
        else []
    )
    when = (
        f", {made['made']['at']}, {made['made']['seconds']:.1f} s"
        if "made" in made
        else ""
    )
    settings = ", ".join(f"{name}={value}" for name, value in own.items())
    packages = ", ".join(f"{name} {value}" for name, value in made["packages"].items())
    return [
        f"made by {step}, seed {made['seed']}{when}",
        f"settings {settings}; and {', '.join(others)} of config.json",
        f"code: commit {made['code']['commit'][:12]}, source {made['code']['source'][:12]}",
        f"packages: {packages}, Python {made['python']}",
    ]
