"""Diagnosis of strings that others measured: `python -m
pipeline.studies.measured.diagnosed ../shared/measured`.

Leaves measured.parquet in tests/benchmarks/measured/results, a row for each string, and
the diagnosis of each in --out. A quarter of an hour of a core each, or more. Rows of
strings that are not asked for stay as they are.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import as_completed
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml
from rich.progress import track

from stringcast.data.artifacts import Diagnosis
from stringcast.data.schema import Column, Table
from stringcast.data.store import write_table, write_text
from stringcast.pipeline.run.provenance import (
    PROJECT_FOLDER,
    code_state,
    software_versions,
)
from stringcast.pipeline.settings.typed_settings import (
    build_dataclass,
    compose_settings,
)
from stringcast.pipeline.studies.blind.study import diagnosis
from stringcast.pipeline.studies.engine import workers
from stringcast.pipeline.studies.measured.family import Family
from stringcast.pipeline.studies.measured.study import WHERE, MeasuredSettings

FOLDER = PROJECT_FOLDER / "tests" / "benchmarks" / "measured" / "results"
RELEASED = "release_"  # trials to which the authors of the cables fitted their model
# the loop that was moved slowly, too, to which no set is fitted
SLOW = "(drive|release|slow)_(?P<string>.+)"
MEASURED = Table(
    "measured",
    "a row for each string that others measured: what was said of it",
    (
        Column("string", "", "its name", "text"),
        Column("trials", "1", "that were used", "int"),
        Column(
            "verdict", "", "none, effect, ambiguous, unknown or insufficient", "text"
        ),
        Column("named", "", "causes and their probabilities, joined by ', '", "text"),
        Column(
            "explained", "", "causes of the extended model, joined by ' + '", "text"
        ),
        Column(
            "unknown", "1", "probability of something that the library does not hold"
        ),
        Column("rms_base", "m", "centre-line residual on trials left out"),
        Column("rms_extended", "m", "centre-line residual on trials left out"),
        Column("noise", "m", "noise floor on these trials"),
        Column(
            "tip_base", "m", "rms of the tip in released trials, fitted to all trials"
        ),
        Column(
            "tip_extended",
            "m",
            "rms of the tip in released trials, fitted to all trials",
        ),
        Column("tip_authors", "m", "the same of the model of those who measured it"),
        Column("seconds", "s", "of the processor, by one core"),
        Column("code", "", "commit that said so", "text"),
    ),
)


def main() -> None:
    """Each string in a process of its own; a row is kept as soon as it is there."""
    parser = argparse.ArgumentParser(
        "python -m pipeline.studies.measured.diagnosed", description=__doc__
    )
    parser.add_argument(
        "measured", type=Path, help="folder with all families, as ../shared/measured"
    )
    parser.add_argument("strings", nargs="*", help="names of strings; all by default")
    parser.add_argument(
        "--out",
        type=Path,
        default=PROJECT_FOLDER / "outputs" / "measured",
        help="datasets and diagnoses",
    )
    parser.add_argument(
        "--processes", type=int, default=0, help="0 is one for each core"
    )
    parser.add_argument(
        "--without",
        action="append",
        default=[],
        help="an effect to do without: no row is kept then",
    )
    asked = parser.parse_args()
    if not asked.measured.is_dir():
        sys.exit(
            f"{asked.measured}: there is no such folder. Name the one that holds all, as ../shared/measured."
        )
    there = {
        s: (f, trials)
        for f in families()
        for s, trials in f.strings(asked.measured).items()
    }
    names = asked.strings or list(there)
    if unknown := set(names) - set(there):
        sys.exit(
            f"there is no {', '.join(sorted(unknown))} in {asked.measured}; there are {', '.join(there)}"
        )
    with workers(asked.processes) as pool:
        runs = {
            pool.submit(
                answer, asked.measured, n, *there[n], asked.out / n, asked.without
            ): n
            for n in names
        }
        for run in track(as_completed(runs), "strings", total=len(runs)):
            if error := run.exception():
                print(f"{runs[run]}: {type(error).__name__}: {error}")
            elif asked.without:
                print(run.result())
            else:
                keep(run.result() | {"code": code_state()["commit"][:7]})


def families() -> list[Family]:
    """The families of the study with all of their trials, frames and points: nothing is
    held out.
    """
    study = build_dataclass(
        MeasuredSettings,
        compose_settings(["+experiment=measured_study"])["measured"],
        "measured",
        WHERE,
    )
    whole = {
        name: replace(f, held_out="", every=1, beyond=0.0)
        for name, f in study.families.items()
    }
    return list((whole | {"cables": replace(whole["cables"], trials=SLOW)}).values())


def answer(
    measured: Path,
    name: str,
    family: Family,
    trials: list[str],
    out: Path,
    without: Sequence[str] = (),
) -> dict[str, Any]:
    """A row of the table but for the code; the diagnosis is left in `out`. without:
    effects that are no candidates.
    """
    family.write(
        measured,
        name,
        trials,
        out / "dataset",
        {"packages": software_versions()["packages"]},
    )
    begun = time.process_time()
    settings = compose_settings(
        ["+experiment=diagnose", f"diagnose.without=[{','.join(without)}]"]
    )
    found = diagnosis(out / "dataset", settings | {"string": family.settings["string"]})
    seconds = time.process_time() - begun
    text = found.finding["diagnosis"].iloc[0]
    write_text(out / "diagnosis.json", text)
    write_text(out / "extended.yaml", found.finding["extended"].iloc[0])
    authors = {"tip_authors": family.authors.get(name, float("nan"))}
    return (
        {"string": name}
        | said(json.loads(text), found)
        | authors
        | {"seconds": seconds}
    )


def said(document: Mapping[str, Any], found: Diagnosis) -> dict[str, Any]:
    """The verdict of a diagnosis, and the errors of its models."""
    causes = {cause["effect"]: cause["probability"] for cause in document["causes"]}
    chances = causes | {
        other["effect"]: other["probability"] for other in document["alternatives"]
    }
    known = yaml.safe_load(found.finding["extended"].iloc[0])["known"]
    rms = {
        name: float("nan") if off is None else off
        for name, off in document["gain"]["rms_m"].items()
    }
    # root mean square distance of the outermost point in released trials [m]; NaN where
    # there are none
    rows = found.residuals
    rows = rows[rows["trial"].str.startswith(RELEASED) & (rows["s"] == rows["s"].max())]
    tip = {}
    for side in ("base", "extended"):
        off = np.hypot(rows["x"] - rows[f"{side}_x"], rows["y"] - rows[f"{side}_y"])
        tip[side] = float(np.sqrt(np.mean(off**2))) if len(rows) else float("nan")
    return {
        "trials": len(document["trials"]["used"]),
        "verdict": document["verdict"],
        "named": ", ".join(f"{cause} {chance:.2f}" for cause, chance in causes.items()),
        "explained": " + ".join(
            sorted({name.split(".")[0] for name in known if "." in name})
        ),
        "unknown": chances.get("unknown", 0.0),
        "rms_base": rms["base"],
        "rms_extended": rms["extended"],
        "noise": rms["noise_floor"],
        "tip_base": tip["base"],
        "tip_extended": tip["extended"],
    }


def keep(row: dict[str, Any]) -> None:
    """Put a row into the table, in place of the one that this string had."""
    print(row)
    table = FOLDER / "measured.parquet"
    before = pd.read_parquet(table).to_dict("records") if table.exists() else []
    rows = [*(old for old in before if old["string"] != row["string"]), row]
    made = {
        "command": f"python -m pipeline.studies.measured.diagnosed {' '.join(sys.argv[1:])}",
        "packages": software_versions()["packages"],
    }
    write_table(
        MEASURED,
        pd.DataFrame(rows).sort_values("string", ignore_index=True),
        table,
        made,
    )


if __name__ == "__main__":
    main()
