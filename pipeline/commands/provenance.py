"""Provenance of stored runs: the commands verify, why, diff and lineage."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
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
from stringcast.pipeline.cli.console import ProgressBar, progress_bars
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

# compared under another heading, or drawn
UNCOMPARED_FILES = frozenset(
    {"config.json", SUMMARY_FILE, FAILURE_FILE, LOG_FILE, "report.html"}
)
# states of a step
FRESH_STATE = "fresh"
STALE_STATE = "stale"
KEPT_STATE = "stale, but stays: the arm has moved by it"
MISSING_STATE = "missing"
UNREPEATABLE_NOTE = "measured with a real arm and camera, cannot be computed again"
StepState = tuple[str, tuple[str, ...]]  # state, and reasons why it is not fresh


def print_block(heading: str, lines: Sequence[str]) -> None:
    """Print indented lines under a heading."""
    print(escape_control_characters("\n    ".join([heading, *lines])))


# --- verify


def verify(arguments: list[str]) -> int:
    """Compute every step of a run again from what is stored, and compare to the bit."""
    run_help = "the run's folder; nothing is written into it"
    (folder,) = parse_paths(verify, arguments, run=run_help)
    experiment = read_stored_experiment(folder)
    console = Terminal(stderr=True)
    with progress_bars(console) as bar, TemporaryDirectory() as scratch:
        comparison = verify_run(experiment, folder, Path(scratch), bar)
    for line in comparison.lines:
        print(escape_control_characters(line))
    return 0 if comparison.is_same else 1


@dataclass
class Comparison:
    """Outcome of a verification.

    Attributes
    ----------
    is_same
        Whether every step is there and came out the same.
    lines
        The outcome of each step in words.
    """

    is_same: bool = True
    lines: list[str] = field(default_factory=list)

    def note(self, name: str, faults: Sequence[str]) -> None:
        """Note the outcome of one comparison."""
        self.lines.append(f"{name}: {'DIFFERS' if faults else 'the same to the bit'}")
        for fault in faults:
            self.lines.append(f"    {fault}")
            self.is_same = False


def verify_run(
    experiment: Experiment, folder: Path, scratch: Path, bar: ProgressBar
) -> Comparison:
    """Compute every step of a run again, and then what the run wrote from them.

    Parameters
    ----------
    experiment : Experiment
        The run's experiment.
    folder : Path
        Folder of the run.
    scratch : Path
        An empty folder to compute in.
    bar : callable
        Makes the progress bar of a step by its name.
    """
    comparison = Comparison()

    def compare_step(step: Step) -> Any:
        stored = load_step_with_staleness(experiment.config, folder, step)
        name = step.folder.as_posix()
        if stored.artifact is None:
            comparison.note(name, stored.stale_reasons)
            raise NotMadeError
        if not is_repeatable(experiment.config, step.stage.folder):
            comparison.lines.append(f"{name}: {UNREPEATABLE_NOTE}")
            return stored.artifact
        with bar(f"{step.number}. {step.stage.name}") as progress:
            artifact = experiment.run_step(step, progress)
            store.save(artifact, scratch / step.folder, {})
        faults = folder_differences(folder / step.folder, scratch / step.folder)
        if faults:
            for reason in stored.stale_reasons:
                faults.append(f"since it was made: {reason}")
        comparison.note(name, faults)
        return stored.artifact

    result = walk_steps(experiment, folder, compare_step)
    if result is not None:
        compare_dataset(experiment, folder, scratch, result, comparison)
        compare_summary(folder, result, comparison)
    return comparison


def compare_dataset(
    experiment: Experiment,
    folder: Path,
    scratch: Path,
    result: RunResult,
    comparison: Comparison,
) -> None:
    """Compare the dataset that a run wrote with the one that its steps make."""
    measured = []
    for iteration in result.iterations:
        if {"trial", "points"} <= iteration.artifacts.keys():
            measured.append(iteration)
    if experiment.config["trials"] is not None or not measured:
        return
    hashes = run_folder.trial_hashes(folder, measured)
    run_folder.publish_dataset(experiment, hashes, scratch, measured)
    faults = []
    for path in (*sorted(scratch.glob("*.parquet")), scratch / "dataset.yaml"):
        for difference in file_differences(folder / path.name, path):
            faults.append(f"{path.name}: {difference}")
    comparison.note("the run as a dataset", faults)


def compare_summary(folder: Path, result: RunResult, comparison: Comparison) -> None:
    """Compare run.json with the summary that the steps give."""
    path = folder / SUMMARY_FILE
    faults = []
    if not path.is_file():
        faults.append("it is missing: the run has not ended; `resume` ends it")
    else:
        stored = json.loads(path.read_text(encoding="utf-8"))
        if stored != json.loads(json.dumps(run_summary(result))):
            faults.append("it says something else than the steps")
    comparison.note(SUMMARY_FILE, faults)


# --- why


def why(arguments: list[str]) -> int:
    """Say of each step of a run whether it is fresh or stale, and why.

    Files and settings are compared; no model is built.
    """
    place_help = "a run's folder, or that of one step: <run>/iterations/01/estimate"
    (place,) = parse_paths(why, arguments, place=place_help)
    folder = run_folder_of(place)
    chosen = place.resolve().relative_to(folder.resolve()).as_posix()
    states = step_states(read_stored_settings(folder), folder)
    names = [name for name in states if chosen in (".", name)]
    if not names:
        known = ", ".join(sorted({stage.folder for stage in stages().values()}))
        raise UserError(
            f"{place}: there is no such step; a study and a calibration have none. "
            "Name the folder of another run, or of a step: "
            f"iterations/<number>/<one of {known}>."
        )
    status = 0
    for name in sorted(names, key=lambda name: Path(name).parent):
        state, reasons = states[name]
        print_block(f"{name}: {state}", reasons)
        if reasons:
            status = 1
    return status


def step_states(settings: Mapping[str, Any], folder: Path) -> dict[str, StepState]:
    """Return the state of each step of a run, after the states of its inputs.

    The next step of an unfinished cast is included as missing.

    Parameters
    ----------
    settings : mapping
        All settings of the run.
    folder : Path
        Folder of the run.

    Returns
    -------
    dict
        States and reasons by the step's folder within the run.
    """
    known = {stage.folder for stage in stages().values()}
    places: dict[str, Path] = {}
    for place in sorted(folder.glob("iterations/*/*")):
        if place.is_dir() and place.name in known:
            places[place.relative_to(folder).as_posix()] = place
    inputs: dict[str, list[str]] = {}  # by the footers of the steps
    for name, place in places.items():
        try:
            stored_inputs = store.read_origin(place).get("inputs", {})
        except (DataError, *store.READ_ERRORS):
            stored_inputs = {}
        inputs[name] = [input_ for input_ in stored_inputs if input_ in places]

    states: dict[str, StepState] = {}
    for name in TopologicalSorter(inputs).static_order():
        place = places[name]
        number = int(place.parent.name)
        reasons = list(stale_reasons(folder, place, settings))
        for input_ in inputs[name]:
            if states[input_][0] == STALE_STATE:
                reasons.append(f"{input_}, an input, is stale")
        state = FRESH_STATE
        if reasons:
            has_moved = arm_has_executed(settings, folder, number, place.name)
            state = KEPT_STATE if has_moved else STALE_STATE
        states[name] = state, tuple(reasons)

    last = max(len({place.parent for place in places.values()}), 1)
    missing = missing_step(settings, folder, last)
    if missing is not None:
        states[missing.as_posix()] = MISSING_STATE, ("it has not been made yet",)
    return states


def missing_step(settings: Mapping[str, Any], folder: Path, number: int) -> Path | None:
    """Return the first step that an iteration of an unfinished run lacks."""
    if (folder / SUMMARY_FILE).exists():
        return None
    for name in settings["mode"].get("stages", ()):
        if name in stages():
            step_folder = artifact_folder(number, stages()[name].folder)
            if not (folder / step_folder).is_dir():
                return step_folder
    return None


# --- diff


def diff(arguments: list[str]) -> int:
    """Say what differs between two runs: settings, data, code, packages, results."""
    run_a, run_b = parse_paths(diff, arguments, a="a run's folder", b="another's")
    first, second = run_facts(run_a), run_facts(run_b)
    status = 0
    for heading, facts in first.items():
        lines = []
        for name, a, b in differing_values(facts, second[heading]):
            lines.append(f"{name}: {a} and {b}")
        if heading == "results":
            lines += folder_differences(run_a, run_b, UNCOMPARED_FILES)
        print_block(f"{heading}: {'differ' if lines else 'the same'}", lines)
        if lines:
            status = 1
    return status


def run_facts(run: Path) -> dict[str, dict[str, Any]]:
    """Return settings, data, code, packages and results of a run, for `diff`.

    Raises
    ------
    UserError
        If there is no run.
    DataError
        If the run has made nothing.
    """
    settings = read_stored_settings(run)
    origins = []
    for file in sorted(run.rglob("*.parquet")):
        origin = store.read_origin(file)
        if "code" in origin:
            origins.append(origin)
    if not origins:
        raise DataError(
            f"{run}: the run has made nothing yet. "
            f"`python -m pipeline resume {run}` continues it."
        )
    first = origins[0]
    data: dict[str, str] = {}
    code = {
        "commit": first["code"]["commit"],
        "all sources": first["code"]["source"][:8],
    }
    for origin in origins:
        code |= origin.get("sources", {})
        for name, digest in origin["inputs"].items():
            if not name.startswith("iterations/"):
                data[Path(name).name] = f"content {digest[:8]}"

    summary_file = run / SUMMARY_FILE
    summary: dict[str, Any] = {"ended": False, "iterations": []}
    if summary_file.exists():
        summary = read_json(summary_file)
    summary["iterations"] = {str(row["number"]): row for row in summary["iterations"]}
    results = {}
    for name, value in flatten_settings(summary).items():
        results[f"run.json: {name}"] = value
    return {
        "settings": flatten_settings(settings),
        "data": data,
        "code": code,
        "packages": first["packages"] | {"Python": first["python"]},
        "results": results,
    }


# --- lineage


def lineage(arguments: list[str]) -> int:
    """Show what made a file: inputs, settings, seed, code and packages."""
    file_help = "a file of a run, or a step's folder"
    (file,) = parse_paths(lineage, arguments, file=file_help)
    tree = Tree(Text(str(file)))
    has_changed = add_origin(tree, file.resolve(), run_folder_of(file), set())
    Terminal(highlight=False).print(tree)
    return 1 if has_changed else 0


def add_origin(tree: Tree, place: Path, run: Path, shown: set[Path | str]) -> bool:
    """Add the origin of a file and of all its inputs to a tree.

    Parameters
    ----------
    tree : Tree
        The tree or branch to add to.
    place : Path
        The file or folder.
    run : Path
        Folder of its run.
    shown : set
        Places and lines that are shown already; changed by it.

    Returns
    -------
    bool
        Whether an input is not as it was.
    """
    origin = {} if place in shown else origin_of_file(place, run)
    shown.add(place)
    for line in describe_origin(origin) if origin else []:
        if line not in shown:
            tree.add(Text(line))
            shown.add(line)

    has_changed = False
    for name, digest in origin.get("inputs", {}).items():
        paths = [path.resolve() for path in (run / name, Path(name)) if path.exists()]
        if not paths:
            tree.add(Text(f"{name} IS GONE"))
            has_changed = True
            continue
        path = paths[0]
        state = change_of(path, digest)
        seen = " (see above)" if path in shown else ""
        branch = tree.add(Text(f"{name}{state}{seen}"))
        input_run = run
        for folder in (path, *path.parents):
            if (folder / "config.json").is_file():
                input_run = folder
                break
        has_changed |= bool(state)
        has_changed |= add_origin(branch, path, input_run, shown)
    return has_changed


def change_of(path: Path, digest: str) -> str:
    """Say how a path differs from its hash; return an empty text if it does not."""
    try:
        return "" if store.content_hash(path) == digest else " HAS CHANGED SINCE"
    except store.READ_ERRORS:
        return " IS DAMAGED"


def origin_of_file(place: Path, run: Path) -> dict[str, Any]:
    """Return the origin of a file or a step's folder; empty if it is not ours.

    A file without a footer was drawn from the steps of its folder: a frame from its
    trial, a report from the last step.
    """
    files: list[Path] = []
    if place.suffix == ".parquet":
        files = [place]
    elif run in (place.parent, place):
        files = sorted(run.glob("iterations/*/*/*.parquet"))[-1:]
    else:
        for folder in (place, *place.parents):
            files = sorted(folder.glob("*.parquet"))
            if files:
                break
    origin = store.read_origin(files[0]) if files else {}
    return origin if "inputs" in origin else {}


def describe_origin(origin: Mapping[str, Any]) -> list[str]:
    """Return lines with step, seed, the step's settings, code and packages."""
    step, config, code = origin["step"], origin["config"], origin["code"]
    made_by = f"made by {step}, seed {origin['seed']}"
    if "made" in origin:
        made_by += f", {origin['made']['at']}, {origin['made']['seconds']:.1f} s"
    own_names = [name for name in (step, "seed") if name in config]
    own_settings = flatten_settings({name: config[name] for name in own_names})
    used = stages()[step].uses if step in stages() else ()
    other_names = [name for name in used if name not in (step, "seed")]
    settings = ", ".join(f"{name}={value}" for name, value in own_settings.items())
    packages = [f"{name} {version}" for name, version in origin["packages"].items()]
    return [
        made_by,
        f"settings {settings}; and {', '.join(other_names)} of config.json",
        f"code: commit {code['commit'][:12]}, source {code['source'][:12]}",
        f"packages: {', '.join(packages)}, Python {origin['python']}",
    ]
