"""Say what differs between two runs: settings, data, code, packages, results."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

from stringcast.data import dataset, store
from stringcast.data.errors import printable
from stringcast.data.schema import DataError
from stringcast.pipeline.compare import differing_files
from stringcast.pipeline.layout import ENDED, FAILED, LOG
from stringcast.pipeline.settings import UserError, leaves
from stringcast.pipeline.staleness import pairs

DRAWN = frozenset({"config.json", ENDED, FAILED, LOG, "report.html"})  # compared by another heading, or drawn
Parts = list[str]


def main(arguments: list[str]) -> int:
    """0 if nothing differs, 1 if anything does."""
    parser = argparse.ArgumentParser("python -m pipeline diff", description=__doc__)
    parser.add_argument("a", type=Path, help="a run's folder")
    parser.add_argument("b", type=Path, help="another's")
    asked = parser.parse_args(arguments)
    found = {heading: differ(asked.a, asked.b) for heading, differ in HEADINGS.items()}
    for heading, words in found.items():
        print(printable("\n    ".join((f"{heading}: {'differ' if words else 'the same'}", *words))))
    return 1 if any(found.values()) else 0


def settings(a: Path, b: Path) -> Parts:
    """Setting by setting."""
    return _said(leaves(_json(a / "config.json")), leaves(_json(b / "config.json")))


def data(a: Path, b: Path) -> Parts:
    """What was read from elsewhere, by content."""
    both = pairs(_outside(a), _outside(b))
    return [f"{name}: {_content(one)} and {_content(other)}" for name, one, other in both]


def code(a: Path, b: Path) -> Parts:
    """The commit, and the source files that the steps were made of."""
    one, other = _made(a)["code"], _made(b)["code"]
    files = [name for name, _, _ in pairs(_sources(a), _sources(b))]
    whole = ["sources that these steps do not use"] if one["source"] != other["source"] else []
    return _said({"commit": one["commit"]}, {"commit": other["commit"]}) + (files or whole)


def packages(a: Path, b: Path) -> Parts:
    """Versions, and Python's."""
    one, other = _made(a), _made(b)
    return _said(one["packages"] | {"Python": one["python"]}, other["packages"] | {"Python": other["python"]})


def results(a: Path, b: Path) -> Parts:
    """run.json number by number, then every table, value by value."""
    numbers = _said(leaves(_numbered(a)), leaves(_numbered(b)), "run.json: ")
    tables = differing_files(a, b, DRAWN)
    return numbers + [f"{name}: {words}" for name, all_words in tables.items() for words in all_words]


HEADINGS: dict[str, Callable[[Path, Path], Parts]] = {
    "settings": settings,
    "data": data,
    "code": code,
    "packages": packages,
    "results": results,
}


def _said(a: dict[str, Any], b: dict[str, Any], place: str = "") -> Parts:
    return [f"{place}{name}: {one} and {other}" for name, one, other in pairs(a, b)]


def _json(path: Path) -> dict[str, Any]:
    """A JSON file of a run. Raises UserError where there is none."""
    if not path.is_file():
        raise UserError(f"{path.parent}: there is no run here (it has no {path.name}). Name a run's folder.")
    return dataset.settings(path)


def _numbered(run: Path) -> dict[str, Any]:
    """run.json with its casts by number instead of a list; little of a run that has not ended."""
    if not (run / ENDED).exists():
        return {"ended": False}
    ended = dataset.settings(run / ENDED)
    return ended | {"iterations": {str(row["number"]): row for row in ended["iterations"]}}


def _origins(run: Path) -> list[dict[str, Any]]:
    """What the footers of a run say; raises DataError where there is none."""
    files = sorted(run.rglob("*.parquet"))
    if not files:
        raise DataError(f"{run}: the run has made nothing yet. `python -m pipeline resume {run}` goes on with it.")
    return [origin for file in files if "code" in (origin := store.origin_of(file))]


def _made(run: Path) -> dict[str, Any]:
    return _origins(run)[0]


def _sources(run: Path) -> dict[str, str]:
    return {name: digest for origin in _origins(run) for name, digest in origin.get("sources", {}).items()}


def _outside(run: Path) -> dict[str, str]:
    """Inputs that were no part of the run, by the name of the file."""
    inputs = {name: digest for origin in _origins(run) for name, digest in origin["inputs"].items()}
    return {Path(name).name: digest for name, digest in inputs.items() if not name.startswith("iterations/")}


def _content(digest: str) -> str:
    return digest if digest == "absent" else f"content {digest[:8]}"
