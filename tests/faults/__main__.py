"""Every kind of fault at every file operation, and kills for longer than the tests have time: `python -m tests.faults`.

Leaves strikes.parquet and kills.parquet in data/results/survival.
"""

import argparse
import os
import tempfile
from pathlib import Path

import pandas as pd
import pytest
from rich.console import Console
from rich.progress import track

from stringcast.data.schema import Column, Table
from stringcast.data.store import write_table
from stringcast.pipeline.provenance import software
from tests.faults.kills import Command, Forked, rounds
from tests.faults.strike import KINDS, strike
from tests.faults.toy import contents, toy_experiment, toy_run

FOLDER = Path(__file__).resolve().parents[2] / "data" / "results" / "survival"
STRIKES = Table(
    "strikes",
    "a row for each fault: toy runs of one cast; every one went on to the uninterrupted result",
    (
        Column("kind", "", "what struck", "text"),
        Column("n", "1", "number of the file operation that it struck", "int"),
        Column("operation", "", "that operation", "text"),
    ),
)
KILLS = Table(
    "kills",
    "a row for each process: killed or ended by itself; every round came to the uninterrupted result, to the bit",
    (
        Column("run", "", "toy stages in a forked process, or the command line", "text"),
        Column("seed", "1", "of the moments", "int"),
        Column("round", "1", "one run, killed until it ended", "int"),
        Column("life", "1", "number of the process within its round", "int"),
        Column("moment", "s", "when it was to be killed, from its start"),
        Column("killed", "", "it was; else it had ended before", "bool"),
        Column("steps", "1", "steps that stood whole on the disk then", "int"),
    ),
)
QUICK = ("+experiment=quick", "manipulations=2", "target.w=0.02", "target.h=0.04", "estimate.candidates=40")


def main() -> None:
    """Strike, kill, keep what came out. An assertion that fails is a fault that was not survived."""
    parser = argparse.ArgumentParser("python -m tests.faults", description=__doc__)
    parser.add_argument("--toy", type=int, default=100, help="rounds of kills with toy stages")
    parser.add_argument("--real", type=int, default=10, help="rounds of kills of the command line")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    made = {"command": f"python -m tests.faults --toy {asked.toy} --real {asked.real} --seed {asked.seed}"}
    made |= software()
    FOLDER.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as place:
        rows = killed(Path(place), asked.toy, asked.real, asked.seed)
        write_table(KILLS, rows, FOLDER / "kills.parquet", made)
        print(rows.groupby("run")["killed"].agg(["size", "sum"]).to_string(header=["processes", "killed"]))
        rows = struck(Path(place))
        write_table(STRIKES, rows, FOLDER / "strikes.parquet", made)
        print(rows.groupby(["kind", "operation"]).size().to_string())


def killed(place: Path, toy: int, real: int, seed: int) -> pd.DataFrame:
    """Rows of KILLS."""
    runs = {"toy": (Forked(toy_experiment(2, pause=0.01)), toy), "command line": (Command(*QUICK), real)}
    rows = [
        {"run": name} | row
        for name, (run, count) in runs.items()
        if count
        for row in rounds(run, place / name, seed, track(range(count), f"kills, {name}", console=Console(stderr=True)))
    ]
    return pd.DataFrame(rows)


def struck(place: Path) -> pd.DataFrame:
    """Rows of STRIKES."""
    os.fsync = lambda handle: None  # type: ignore[assignment]
    here = toy_experiment(1)
    toy_run(place / "whole", here)
    whole = contents(place / "whole")
    rows = []
    for kind in track(KINDS, "faults", console=Console(stderr=True)):
        n = 0
        while operation := strike(pytest.MonkeyPatch.context, n, kind, here, place / str(n), whole):
            rows.append({"kind": kind, "n": n, "operation": operation})
            n += 1
    return pd.DataFrame(rows)


if __name__ == "__main__":
    main()
