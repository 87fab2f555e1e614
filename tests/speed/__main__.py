"""`python3 tasks.py bench`: measure, print the table, and keep it as Parquet and as a
picture.

`python3 tasks.py bench waits` measures what the user waits for, alone, and keeps
nothing; `bench estimates` measures estimation alone, and keeps it.
"""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Sequence
from dataclasses import fields
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pandas as pd
from rich.console import Console
from rich.table import Table as Printed

from stringcast.data.schema import Column, Table
from stringcast.data.store import write_table
from stringcast.pipeline.run.provenance import code_state, software_versions
from tests.speed.estimates import ESTIMATES, estimates, summary
from tests.speed.measures import Row, framed, measured
from tests.speed.picture import picture
from tests.speed.waits import waits

FOLDER = Path(__file__).resolve().parents[2] / "outputs" / "speed"
COMMAND = "python3 tasks.py bench"
PEERS = ("mujoco", "pyelastica")
MEANING = {
    "measure": "what is measured",
    "subject": "of what",
    "value": "median over the rounds, or the one value",
    "unit": "of value, low, high and goals",
    "low": "smallest of the rounds",
    "high": "largest of the rounds",
    "points": "mass points, links or elements",
    "threads": "threads at work",
    "batch": "candidates simulated at once",
    "at_least": "goal: not less than this",
    "at_most": "goal: not more than this",
}
NUMBERS = {field.name for field in fields(Row)} - {"measure", "subject", "unit"}
SPEED = Table(
    "speed",
    "How fast strings are simulated, and beside what",
    tuple(
        Column(name, "", meaning, "float" if name in NUMBERS else "text")
        for name, meaning in MEANING.items()
    ),
)


def main(parts: list[str]) -> None:
    """Measure, print, keep."""
    if parts == ["waits"]:
        Console(width=150).print(printed(framed(waits())))
        return
    FOLDER.mkdir(parents=True, exist_ok=True)
    alone = parts == ["estimates"]
    made = origin(() if alone else PEERS)
    estimated = estimates()
    write_table(ESTIMATES, estimated, FOLDER / "estimates.parquet", made)
    rows = framed(
        summary(estimated) if alone else [*waits(), *measured(), *summary(estimated)]
    )
    Console(width=150).print(printed(rows))
    if not alone:
        write_table(SPEED, rows, FOLDER / "speed.parquet", made)
        picture(rows, FOLDER / "speed.png")
    print(f"Kept in {FOLDER}")


def printed(rows: pd.DataFrame) -> Printed:
    """The table for people: a measure's name once, goals marked as met or not."""
    out = Printed(title=f"Speed of the string engine on {processor()}")
    for name in ("measure", "subject", "n", "threads", "batch"):
        out.add_column(
            name, justify="left" if name in ("measure", "subject") else "right"
        )
    for name in ("median", "range", "unit", "goal"):
        out.add_column(name, justify="right" if name != "unit" else "left")
    last = ""
    for row in rows.itertuples():
        if row.measure != last and last:
            out.add_section()
        counts = [
            "" if np.isnan(count) else f"{count:.0f}"
            for count in (row.points, row.threads, row.batch)
        ]
        spread = "" if np.isnan(row.low) else f"{row.low:.3g} to {row.high:.3g}"
        name = "" if row.measure == last else row.measure
        out.add_row(
            name, row.subject, *counts, f"{row.value:.3g}", spread, row.unit, goal(row)
        )
        last = row.measure
    return out


def goal(row) -> str:  # type: ignore[no-untyped-def]
    """The goal in words, and whether it is met."""
    if not np.isnan(row.at_least):
        return f"≥ {row.at_least:g}: " + (
            "[green]met" if row.value >= row.at_least else "[red]missed"
        )
    if not np.isnan(row.at_most):
        return f"≤ {row.at_most:g}: " + (
            "[green]met" if row.value <= row.at_most else "[red]missed"
        )
    return ""


def origin(peers: Sequence[str]) -> dict[str, object]:
    """What makes a table. peers: packages that it compares with."""
    return {
        "command": COMMAND,
        "machine": {
            "processor": processor(),
            "cores": os.cpu_count(),
            "load": os.getloadavg()[0],
        },
        "system": platform.platform(),
        "python": platform.python_version(),
        "packages": software_versions()["packages"]
        | {name: version(name) for name in ("llvmlite", *peers)},
        "code": code_state(),
    }


def processor() -> str:
    """The processor's name, and what LLVM takes it for."""
    import llvmlite.binding

    names = [
        line.split(":")[1].strip()
        for line in _lines("/proc/cpuinfo")
        if line.startswith("model name")
    ]
    return f"{names[0] if names else platform.processor()} ({llvmlite.binding.get_host_cpu_name()})"


def _lines(path: str) -> list[str]:
    file = Path(path)
    return file.read_text().splitlines() if file.exists() else []


if __name__ == "__main__":
    main(sys.argv[1:])
