"""Say what differs between two runs: settings, data, code, packages, results."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from stringcast.data import store
from stringcast.data.compare import folder_differences
from stringcast.data.file_checks import read_json
from stringcast.data.schema import DataError
from stringcast.pipeline.commands import CommandParser, print_block
from stringcast.pipeline.commands.stored_runs import read_stored_settings
from stringcast.pipeline.run.file_names import FAILURE_FILE, LOG_FILE, SUMMARY_FILE
from stringcast.pipeline.run.provenance import differing_values
from stringcast.pipeline.settings.composition import flatten_settings

# compared under another heading, or drawn
UNCOMPARED_FILES = frozenset(
    {"config.json", SUMMARY_FILE, FAILURE_FILE, LOG_FILE, "report.html"}
)


def main(arguments: list[str]) -> int:
    """Print the differences under five headings; return 0 if there are none."""
    parser = CommandParser("python -m pipeline diff", description=__doc__)
    parser.add_argument("a", type=Path, help="a run's folder")
    parser.add_argument("b", type=Path, help="the folder of another run")
    runs = parser.parse_args(arguments)
    first, second = run_facts(runs.a), run_facts(runs.b)
    has_difference = False
    for heading, facts in first.items():
        lines = []
        for name, a, b in differing_values(facts, second[heading]):
            lines.append(f"{name}: {a} and {b}")
        if heading == "results":
            lines += folder_differences(runs.a, runs.b, UNCOMPARED_FILES)
        print_block(f"{heading}: {'differ' if lines else 'the same'}", lines)
        has_difference |= bool(lines)
    return int(has_difference)


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
    code = first["code"]
    data: dict[str, str] = {}
    for origin in origins:
        for name, digest in origin["inputs"].items():
            if not name.startswith("iterations/"):
                data[Path(name).name] = f"content {digest[:8]}"

    summary: dict[str, Any] = {"ended": False, "iterations": []}
    if (run / SUMMARY_FILE).exists():
        summary = read_json(run / SUMMARY_FILE)
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
