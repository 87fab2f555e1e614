"""Folders of measured data: a run of ours, or anybody's (shared format, version 1).

A dataset is one folder: `arm` or `grasp`, `points`, each as Parquet or CSV with the leading
column `trial`, and `dataset.yaml`. A run of ours also keeps `readings` and `masks`, so that
estimation from disk sees exactly what it saw in the run.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from data.artifacts import ARM, GRASP, MASKS, POINTS, READINGS, Observation, Points, Trial
from data.schema import Column, DataError, Table
from data.store import read_table, write_table, write_text

FORMAT = 1
TRIAL = Column("trial", "", "name of the trial", "text")
BEYOND = 1.05  # times the string's length: points further along are another string's
OVERLAP = 0.1  # [s] that arm and camera must have in common


def with_trial(table: Table) -> Table:
    """The same table with the leading column `trial`."""
    return Table(table.name, table.meaning, (TRIAL, *table.columns))


@dataclass(frozen=True)
class Dataset:
    """trials: what can be used, by name. rejected: why the others cannot. about: dataset.yaml."""

    folder: Path
    trials: Mapping[str, Observation]
    rejected: Mapping[str, str]
    about: Mapping[str, Any]


def publish(
    folder: Path, trials: Mapping[str, tuple[Trial, Points]], known: Mapping[str, Any], origin: Mapping[str, Any]
) -> None:
    """Write trials of ours as a dataset; each file is replaced whole, `dataset.yaml` last.

    known: what dataset.yaml says beside the format. origin: goes into every footer.
    """
    tables = {
        ARM: {name: trial.arm for name, (trial, _) in trials.items()},
        POINTS: {name: points.points for name, (_, points) in trials.items()},
        READINGS: {name: points.readings for name, (_, points) in trials.items()},
        MASKS: {name: points.masks for name, (_, points) in trials.items()},
    }
    for table, parts in tables.items():
        whole = pd.concat([part.assign(trial=name) for name, part in parts.items()], ignore_index=True)
        write_table(with_trial(table), whole, folder / f"{table.name}.parquet", origin)
    write_text(folder / "dataset.yaml", yaml.safe_dump({"format": FORMAT, **known}, sort_keys=False))


def read(folder: Path) -> Dataset:
    """Read a dataset; raises DataError naming the file and the remedy. Damaged rows are left out."""
    if not folder.is_dir():
        raise DataError(f"trials={folder}: there is no such folder. Name a run's folder or one in the data format.")
    known = about(folder)
    motion_table = ARM if _find(folder, "arm") else GRASP
    motion = _read(motion_table, folder)
    points = _read(POINTS, folder)
    extra = {t.name: _read(t, folder) for t in (READINGS, MASKS) if _find(folder, t.name)}
    trials, rejected = {}, {}
    for name in sorted(set(motion["trial"]) | set(points["trial"])):
        parts = [_of(frame, name) for frame in (motion, points)]
        reason = _unusable(*parts)
        if reason:
            rejected[name] = reason
            continue
        kept = [_of(extra[t.name], name) if t.name in extra else t.empty() for t in (READINGS, MASKS)]
        given = {"arm": parts[0]} if motion_table is ARM else {"grasp": parts[0]}
        trials[name] = Observation(name, parts[1], *kept, **given)
    return Dataset(folder, trials, rejected, known)


def about(folder: Path) -> dict[str, Any]:
    """What dataset.yaml says, or nothing where it is missing; raises DataError where it is damaged."""
    path = folder / "dataset.yaml"
    if not path.exists():
        return {}
    try:
        known = yaml.safe_load(path.read_text(encoding="utf-8")) or {}
    except yaml.YAMLError as error:
        raise DataError(f"{path}: not valid YAML ({error}). Correct the line it names.") from error
    if known.get("format", FORMAT) != FORMAT:
        raise DataError(f"{path}: format is {known['format']!r}; this version reads {FORMAT}. Convert it.")
    return known


def _find(folder: Path, name: str) -> Path | None:
    return next((folder / f"{name}{end}" for end in (".parquet", ".csv") if (folder / f"{name}{end}").exists()), None)


def _read(table: Table, folder: Path) -> pd.DataFrame:
    """One table, without rows that cannot be used and without duplicates, in time order."""
    path = _find(folder, table.name)
    if path is None:
        raise DataError(f"{folder}: neither {table.name}.parquet nor {table.name}.csv. Add it, with column 'trial'.")
    whole = with_trial(table)
    frame = whole.check(pd.read_csv(path), str(path)) if path.suffix == ".csv" else read_table(whole, path)
    numbers = [c.name for c in table.columns if c.kind == "float" and not c.optional and c.unit]
    if table in (ARM, GRASP, POINTS):
        frame = frame[np.isfinite(frame[numbers]).all(axis=1)]
        keys = ["trial", "t", "s"] if table is POINTS else ["trial", "t"]
        frame = frame.drop_duplicates(keys)
    return frame.sort_values(["trial", "t"], kind="stable").reset_index(drop=True)


def _of(frame: pd.DataFrame, name: str) -> pd.DataFrame:
    """The rows of one trial."""
    return frame[frame["trial"] == name].drop(columns="trial").reset_index(drop=True)


def fits(data: Dataset, length: float) -> Dataset:
    """Without the trials whose points lie further along than a string of `length` [m] is long."""
    beyond = {name: float(o.points["s"].max()) for name, o in data.trials.items()}
    long = {name: s for name, s in beyond.items() if s > BEYOND * length}
    reasons = {
        name: f"points up to s = {s:.3f} m on a string of {length:.3f} m (string.length)" for name, s in long.items()
    }
    kept = {name: o for name, o in data.trials.items() if name not in long}
    return Dataset(data.folder, kept, {**data.rejected, **reasons}, data.about)


def _unusable(motion: pd.DataFrame, points: pd.DataFrame) -> str:
    """Why a trial cannot be used; empty if it can."""
    if motion.empty:
        return "no motion of the hand"
    if points.empty:
        return "no measured point"
    common = min(motion["t"].max(), points["t"].max()) - max(motion["t"].min(), points["t"].min())
    return f"arm and camera overlap for {max(common, 0):.2f} s only" if common < OVERLAP else ""
