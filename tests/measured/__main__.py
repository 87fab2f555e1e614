"""What is said of strings that others measured: `python -m tests.measured ../shared/measured`. Leaves measured.parquet in
data/results/measured, a row for each string, and the diagnosis of each in --out.

A quarter of an hour of a core each, or more. Rows of strings that are not asked for stay as they are.
"""

import argparse
import sys
from concurrent.futures import as_completed
from pathlib import Path
from typing import Any

import pandas as pd
from rich.progress import track

from stringcast.data.schema import Column, Table
from stringcast.data.store import write_table
from stringcast.pipeline.origin import PACKAGES, code, versions
from stringcast.pipeline.study.benches import workers
from tests.measured.answers import answer
from tests.measured.sets import sets

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "data" / "results" / "measured"
MEASURED = Table(
    "measured",
    "a row for each string that others measured: what was said of it",
    (
        Column("string", "", "its name", "text"),
        Column("trials", "1", "that were used", "int"),
        Column("verdict", "", "none, effect, ambiguous, unknown or insufficient", "text"),
        Column("named", "", "causes and their probabilities, joined by ', '", "text"),
        Column("explained", "", "causes of the extended model, joined by ' + '", "text"),
        Column("unknown", "1", "probability of something that the library does not hold"),
        Column("rms_base", "m", "centre-line residual on trials left out"),
        Column("rms_extended", "m", "centre-line residual on trials left out"),
        Column("noise", "m", "noise floor on these trials"),
        Column("tip_base", "m", "rms of the tip in released trials, fitted to all trials"),
        Column("tip_extended", "m", "rms of the tip in released trials, fitted to all trials"),
        Column("tip_authors", "m", "the same of the model of those who measured it"),
        Column("seconds", "s", "on one core, which other work may have used too"),
        Column("code", "", "commit that said so", "text"),
    ),
)


def main() -> None:
    """Each string in a process of its own; a row is kept as soon as it is there."""
    asked = arguments()
    if not asked.measured.is_dir():
        sys.exit(
            f"{asked.measured}: there is no such folder. Name the one that holds both sets, as ../shared/measured."
        )
    there = sets(asked.measured)
    names = asked.strings or list(there)
    if unknown := set(names) - set(there):
        sys.exit(f"there is no {', '.join(sorted(unknown))} in {asked.measured}; there are {', '.join(there)}")
    with workers(asked.processes) as pool:
        runs = {pool.submit(answer, asked.measured, name, there[name], asked.out / name): name for name in names}
        for run in track(as_completed(runs), "strings", total=len(runs)):
            if error := run.exception():
                print(f"{runs[run]}: {type(error).__name__}: {error}")
            else:
                keep(run.result() | {"code": code()["commit"][:7]})


def arguments() -> argparse.Namespace:
    """What is asked for."""
    parser = argparse.ArgumentParser("python -m tests.measured", description=__doc__)
    parser.add_argument("measured", type=Path, help="folder with both sets, as ../shared/measured")
    parser.add_argument("strings", nargs="*", help="names of strings; all by default")
    parser.add_argument("--out", type=Path, default=ROOT / "outputs" / "measured", help="datasets and diagnoses")
    parser.add_argument("--processes", type=int, default=0, help="0 is one for each core")
    return parser.parse_args()


def keep(row: dict[str, Any]) -> None:
    """Put a row into the table, in place of the one that this string had."""
    print(row)
    FOLDER.mkdir(parents=True, exist_ok=True)
    table = FOLDER / "measured.parquet"
    before = pd.read_parquet(table).to_dict("records") if table.exists() else []
    rows = [*(old for old in before if old["string"] != row["string"]), row]
    made = {"command": f"python -m tests.measured {' '.join(sys.argv[1:])}", "packages": versions(PACKAGES)}
    write_table(MEASURED, pd.DataFrame(rows).sort_values("string", ignore_index=True), table, made)


if __name__ == "__main__":
    main()
