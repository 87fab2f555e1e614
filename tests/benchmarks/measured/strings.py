"""Diagnosis of measured strings: `python3 tasks.py study strings ../shared/measured`.

Writes results/strings.parquet, a row for each string and seed, and each diagnosis to
--out. Takes one to six minutes of a core for a row. Other rows stay as they are.
"""

from __future__ import annotations

import argparse
import json
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

from stringcast.data.diagnoses import Diagnosis
from stringcast.data.schema import Column, Table
from stringcast.data.store import write_table, write_text
from stringcast.pipeline.run.provenance import (
    PROJECT_FOLDER,
    code_state,
    software_versions,
)
from stringcast.pipeline.settings.composition import UserError, compose_settings
from stringcast.pipeline.settings.typed_settings import build_dataclass
from tests.benchmarks.diagnosis.study import diagnose_dataset
from tests.benchmarks.measured.family import Family
from tests.benchmarks.measured.study import WHERE, MeasuredSettings
from tests.benchmarks.study import study_settings, worker_pool

TABLE_FILE = Path(__file__).with_name("results") / "strings.parquet"
RELEASED = "release_"  # trials to which the authors of the cables fitted their model
# includes the slow loop, to which no set is fitted
ALL_CABLE_TRIALS = "(drive|release|slow)_(?P<string>.+)"
STRINGS = Table(
    "strings",
    "a row for each measured string and seed: its diagnosis",
    (
        Column("string", "", "its name", "text"),
        Column("seed", "1", "of the search", "int"),
        Column("trials", "1", "used trials", "int"),
        Column(
            "verdict",
            "",
            "none, effect, ambiguous, partial, unknown or insufficient",
            "text",
        ),
        Column("named", "", "causes and their probabilities, joined by ', '", "text"),
        Column(
            "explained", "", "causes of the extended model, joined by ' + '", "text"
        ),
        Column("set_aside", "", "causes that were found and dropped", "text"),
        Column("left", "m", "what the extended model leaves at the tips, rms"),
        Column(
            "rms_base", "m", "centre-line residual of the base model in left-out trials"
        ),
        Column(
            "rms_extended",
            "m",
            "centre-line residual of the extended model in left-out trials",
        ),
        Column("noise", "m", "noise floor of these trials"),
        Column(
            "tip_base",
            "m",
            "rms of the tip in released trials, base model fitted to all trials",
        ),
        Column(
            "tip_extended",
            "m",
            "rms of the tip in released trials, extended model fitted to all trials",
        ),
        Column("tip_authors", "m", "rms of the tip in released trials, authors' model"),
        Column("seconds", "s", "processor time"),
        Column("code", "", "commit of the code", "text"),
    ),
)


def main(arguments: Sequence[str]) -> None:
    """Diagnose each string in its own process, and keep each row when it is ready."""
    parser = argparse.ArgumentParser(
        "python3 tasks.py study strings", description=__doc__
    )
    parser.add_argument(
        "source", type=Path, help="folder of all families, as ../shared/measured"
    )
    parser.add_argument("strings", nargs="*", help="names of strings; all by default")
    parser.add_argument(
        "--out",
        type=Path,
        default=PROJECT_FOLDER / "outputs" / "strings",
        help="datasets and diagnoses",
    )
    parser.add_argument(
        "--processes", type=int, default=0, help="0 is one for each core"
    )
    parser.add_argument(
        "--without",
        action="append",
        default=[],
        help="an effect to exclude; no row is kept then",
    )
    parser.add_argument(
        "--seeds", type=int, default=1, help="number of seeds, from 0 on"
    )
    options = parser.parse_args(arguments)
    known = {}
    for family in families_with_all_trials():
        for string, trials in family.trials_by_string(options.source).items():
            known[string] = family, trials
    strings = options.strings or list(known)
    if unknown := set(strings) - set(known):
        raise UserError(
            options.source,
            f"there is no {', '.join(sorted(unknown))}; there are {', '.join(known)}",
        )

    jobs = []
    for string in strings:
        family, trials = known[string]
        dataset = options.out / string / "dataset"
        packages = {"packages": software_versions()["packages"]}
        family.write(options.source, string, trials, dataset, packages)
        for seed in range(options.seeds):
            jobs.append((string, seed, family, dataset, options.without))
    with worker_pool(options.processes) as pool:
        names = {pool.submit(diagnose_string, *job): job[0] for job in jobs}
        for future in track(as_completed(names), "strings", total=len(names)):
            if error := future.exception():
                print(f"{names[future]}: {type(error).__name__}: {error}")
                continue
            row = future.result()
            print(row)
            if not options.without:
                keep_row(row | {"code": code_state()["commit"][:7]}, arguments)


def families_with_all_trials() -> list[Family]:
    """Return the families of the study with all trials, frames and points.

    Nothing is held out.
    """
    composed = study_settings("measured", ["measured.source=."])
    settings = build_dataclass(
        MeasuredSettings, composed["measured"], "measured", WHERE
    )
    families = {}
    for name, family in settings.families.items():
        families[name] = replace(family, held_out="", every=1, beyond=0.0)
    families["cables"] = replace(families["cables"], trials=ALL_CABLE_TRIALS)
    return list(families.values())


def diagnose_string(
    name: str, seed: int, family: Family, dataset: Path, without: Sequence[str]
) -> dict[str, Any]:
    """Return a row of the table, without the code; write the diagnosis beside it."""
    excluded = ",".join(without)
    settings = compose_settings(
        [
            "+experiment=diagnose",
            f"seed={seed}",
            f"diagnose.excluded_effects=[{excluded}]",
        ]
    )
    started = time.process_time()
    diagnosis = diagnose_dataset(
        dataset, settings | {"string": family.settings["string"]}
    )
    seconds = time.process_time() - started

    text = diagnosis.finding["diagnosis"].iloc[0]
    folder = dataset.parent / f"seed_{seed}"
    write_text(folder / "diagnosis.json", text)
    write_text(folder / "extended.yaml", diagnosis.finding["extended"].iloc[0])
    row = summarise(json.loads(text), diagnosis)
    authors = family.authors.get(name, float("nan"))
    return {
        "string": name,
        "seed": seed,
        **row,
        "tip_authors": authors,
        "seconds": seconds,
    }


def summarise(document: Mapping[str, Any], diagnosis: Diagnosis) -> dict[str, Any]:
    """Return the verdict of a diagnosis and the errors of its models."""
    named = []
    for cause in document["causes"]:
        named.append(f"{cause['effect']} {cause['probability']:.2f}")
    extended = yaml.safe_load(diagnosis.finding["extended"].iloc[0])
    explained = set()
    for name in extended["parameter_values"]:
        if "." in name:
            explained.add(name.split(".")[0])
    rms = dict.fromkeys(("base", "extended", "noise_floor"), float("nan"))
    for name, value in document["gain"]["rms_m"].items():
        if value is not None:
            rms[name] = value
    return {
        "trials": len(document["trials"]["used"]),
        "verdict": document["verdict"],
        "named": ", ".join(named),
        "explained": " + ".join(sorted(explained)),
        "set_aside": ", ".join(each["effect"] for each in document["set_aside"]),
        "left": document["unexplained"]["tip_rms_m"]["value"],
        "rms_base": rms["base"],
        "rms_extended": rms["extended"],
        "noise": rms["noise_floor"],
        "tip_base": released_tip_rms(diagnosis.residuals, "base"),
        "tip_extended": released_tip_rms(diagnosis.residuals, "extended"),
    }


def released_tip_rms(residuals: pd.DataFrame, model: str) -> float:
    """Return the rms distance of the outermost point in released trials [m].

    It is NaN without such trials.
    """
    is_tip = residuals["s"] == residuals["s"].max()
    tip = residuals[residuals["trial"].str.startswith(RELEASED) & is_tip]
    distances = np.hypot(tip["x"] - tip[f"{model}_x"], tip["y"] - tip[f"{model}_y"])
    return float(np.sqrt(np.mean(distances**2))) if len(tip) else float("nan")


def keep_row(row: dict[str, Any], arguments: Sequence[str]) -> None:
    """Put a row into the table, in place of an earlier one of its string and seed."""
    key = ["string", "seed"]
    rows = pd.DataFrame([row])
    if TABLE_FILE.exists():
        before = pd.read_parquet(TABLE_FILE)
        rows = pd.concat([before, rows], ignore_index=True)
    rows = rows.drop_duplicates(key, keep="last").sort_values(key, ignore_index=True)
    made_by = {
        "command": " ".join(["python3 tasks.py study strings", *arguments]),
        "packages": software_versions()["packages"],
    }
    write_table(STRINGS, rows, TABLE_FILE, made_by)
