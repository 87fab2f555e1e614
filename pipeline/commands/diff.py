"""Say what differs between two runs: settings, data, code, packages, results."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from stringcast.data import store
from stringcast.data.compare import folder_differences
from stringcast.data.schema import DataError
from stringcast.pipeline.cli.terminal import Terminal
from stringcast.pipeline.commands import CommandParser, print_block
from stringcast.pipeline.commands.stored_runs import read_stored_settings
from stringcast.pipeline.run.file_names import FAILURE_FILE, LOG_FILE, SUMMARY_FILE
from stringcast.pipeline.run.provenance import (
    PARTS_OF_ORIGIN,
    UNKNOWN_CODE,
    differing_values,
)
from stringcast.pipeline.run.result import read_summary
from stringcast.pipeline.settings.composition import flatten_settings
from stringcast.stages.report.formatting import join_names

# compared under another heading, or a picture
UNCOMPARED_FILES = frozenset(
    {"config.json", SUMMARY_FILE, FAILURE_FILE, LOG_FILE, "report.html"}
)

MAX_NAMES_SHOWN = 4  # names of differences in the conclusion


def main(arguments: list[str]) -> int:
    """Print the differences under five headings, and a conclusion.

    The exit status is 0 without differences.
    """
    parser = CommandParser("python -m pipeline diff", description=__doc__)
    parser.add_argument("a", type=Path, help="a run's folder")
    parser.add_argument("b", type=Path, help="the folder of another run")
    runs = parser.parse_args(arguments)
    first, second = run_facts(runs.a), run_facts(runs.b)
    names_by_heading: dict[str, list[str]] = {}
    for heading, facts in first.items():
        lines = []
        for name, a, b in differing_values(facts, second[heading]):
            lines.append(f"{name}: {a} and {b}")
        names_by_heading[heading] = [line.partition(":")[0] for line in lines]
        if heading == "results":
            lines += folder_differences(runs.a, runs.b, UNCOMPARED_FILES)
            names_by_heading[heading] = lines
        print_block(f"{heading}: {'differ' if lines else 'the same'}", lines)
    outcomes = [describe_outcome(facts["results"]) for facts in (first, second)]
    Terminal().print_line(conclusion(names_by_heading, outcomes))
    return int(any(names_by_heading.values()))


def conclusion(
    names_by_heading: Mapping[str, Sequence[str]], outcomes: Sequence[str]
) -> str:
    """Describe the differences, and whether they can explain the results."""
    reasons = []
    for heading, names in names_by_heading.items():
        if names and heading != "results":
            shown = ", ".join(names[:MAX_NAMES_SHOWN])
            more = len(names) - MAX_NAMES_SHOWN
            if more > 0:
                shown += f" and {more} more"
            reasons.append(f"{heading} ({shown})")
    made_of = join_names(reasons)
    if not names_by_heading["results"]:
        if not reasons:
            return "The two runs are the same in everything that was compared."
        return f"The results are the same, though these differ: {made_of}."
    ended = f"The first run {outcomes[0]}, the second {outcomes[1]}."
    if outcomes[0] == outcomes[1]:
        ended = f"Both runs {outcomes[0]}, with results that differ in detail."
    if reasons:
        return f"{ended} What can explain it: {made_of}."
    return f"{ended} Nothing that they were made of differs: check the machines."


def describe_outcome(results: Mapping[str, Any]) -> str:
    """Describe the outcome of a run from the values of its run.json."""
    if results.get("run.json: ended") is False:
        return "has not ended"
    misses, rates = [], []
    for name, value in results.items():
        if name.endswith(".miss_m") and value is not None:
            misses.append(value)
        if name.endswith(".E_after") and value is not None:
            rates.append(value)
    words = str(results.get("run.json: sentence", "ended")).rstrip(".")
    words = f'ended with "{words}"'
    if misses:
        hit = "hit" if results["run.json: hit"] else "missed"
        words = f"{hit} after {len(misses)} casts ({1e3 * misses[-1]:.1f} mm at last)"
    return f"{words}, E {rates[-1]:.3f}" if rates else words


def run_facts(run: Path) -> dict[str, dict[str, Any]]:
    """Return settings, data, code, packages and results of a run, for `diff`.

    Raises UserError without a run, and DataError for a run without steps.
    """
    settings = read_stored_settings(run)
    origins = []
    for file in sorted(run.rglob("*.parquet")):
        origin = store.read_origin(file)
        if origin.keys() >= PARTS_OF_ORIGIN:
            origins.append(origin)
    if not origins:
        raise DataError(
            run,
            "the run has made nothing yet",
            f"`python -m pipeline resume {shlex.quote(str(run))}` continues it.",
        )
    first = origins[0]
    code = UNKNOWN_CODE | first["code"]
    data: dict[str, str] = {}
    for origin in origins:
        for name, digest in origin["inputs"].items():
            if not name.startswith("iterations/"):
                data[Path(name).name] = f"content {digest[:8]}"

    summary = read_summary(run) or {"ended": False, "iterations": []}
    summary["iterations"] = {str(row["number"]): row for row in summary["iterations"]}
    results = {}
    for name, value in flatten_settings(summary).items():
        results[f"run.json: {name}"] = value
    return {
        "settings": flatten_settings(settings),
        "data": data,
        "code": {"commit": code["commit"], "all sources": code["source"][:8]},
        "packages": first["packages"] | {"Python": first["python"]},
        "results": results,
    }
