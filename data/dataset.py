"""Folders of measured data: a run of ours, or anybody's (format version 1, in `data/README.md`).

A dataset is one folder: `arm` or `grasp`, and `points`, each as Parquet or CSV with the
leading column `trial`, and `dataset.yaml`. Where points are yet to be made there are frames
instead, listed in `frames`, or a video for each trial. A run of ours also keeps `readings`
and `masks`, so that estimation from disk sees exactly what it saw in the run.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from stringcast.data.artifacts import ARM, FRAMES, GRASP, MASKS, POINTS, READINGS, Film, Observation, Points, Trial
from stringcast.data.errors import printable
from stringcast.data.foreign import inside, leaves, own
from stringcast.data.images import ImageFiles, Shots, filmed, listed, videos
from stringcast.data.metadata import FORMAT, NAME, metadata
from stringcast.data.rows import Rows, cleaned, from_csv
from stringcast.data.schema import Column, DataError, Table
from stringcast.data.store import content_hash, read_table, write_table, write_text

TRIAL = Column("trial", "", "name of the trial", "text")
PUBLISHED = (ARM, FRAMES, POINTS, READINGS, MASKS)  # of trials of ours
BEYOND = 1.05  # times the string's length: points further along are another string's
STRAY = 0.05  # of a trial's points: so few that lie beyond are left out, and not the trial
SINCE_1970 = (1e9, 4e9)  # [s]: 2001 to 2096
OVERLAP = 0.1  # [s] that arm and camera must have in common
FRAMES_NEEDED = 3  # in which the string was seen
MOST_TRIALS = 4000  # each takes a millisecond to set apart, and seconds to simulate once
LATE = 10.0  # [s] from which a clock began long before its trial, whose times are then counted from a second of its own


def with_trial(table: Table) -> Table:
    """A table with the additional leading column `trial`."""
    return Table(table.name, table.meaning, (TRIAL, *table.columns))


@dataclass(frozen=True)
class Unusable:
    """Why a trial cannot be used. file: dataset.yaml, or the name of the table in which that is so. field: key or
    column there."""

    reason: str
    remedy: str
    file: str
    field: str


@dataclass(frozen=True)
class Dataset:
    """trials: what can be used, by name. films: their frames, where there are any. unusable: why the others
    cannot. metadata: dataset.yaml. hashes: of every file that was read, by name. rows: what became of the rows of the
    tables that were measured, by file. clocks: what was taken from the times of a trial [s], where its clock began
    long before it."""

    folder: Path
    trials: Mapping[str, Observation]
    films: Mapping[str, Film]
    unusable: Mapping[str, Unusable]
    metadata: Mapping[str, Any]
    hashes: Mapping[str, str]
    rows: Mapping[str, Rows] = field(default_factory=dict)
    clocks: Mapping[str, float] = field(default_factory=dict)

    @property
    def rejected(self) -> dict[str, str]:
        """The reasons of trials that cannot be used, by name."""
        return {name: fault.reason for name, fault in self.unusable.items()}


def publish(
    folder: Path,
    trials: Mapping[str, tuple[Trial, Points]],
    places: Mapping[str, Path],
    known: Mapping[str, Any],
    origin: Mapping[str, Any],
) -> None:
    """Write trials of ours as a dataset; each file is replaced whole, `dataset.yaml` last.

    places: the folder of each trial's frames, relative to `folder`. known: what dataset.yaml
    says beside the format. origin: goes into every footer.
    """
    frames = {name: trial.frames for name, (trial, _) in trials.items()}
    files = {name: [(places[name] / file).as_posix() for file in frame["file"]] for name, frame in frames.items()}
    tables = {
        ARM: {name: trial.arm for name, (trial, _) in trials.items()},
        FRAMES: {name: frame.assign(file=files[name]) for name, frame in frames.items()},
        POINTS: {name: points.points for name, (_, points) in trials.items()},
        READINGS: {name: points.readings for name, (_, points) in trials.items()},
        MASKS: {name: points.masks for name, (_, points) in trials.items()},
    }
    for table, parts in tables.items():
        whole = pd.concat([part.assign(trial=name) for name, part in parts.items()], ignore_index=True)
        write_table(with_trial(table), whole, folder / f"{table.name}.parquet", origin)
    write_text(folder / NAME, yaml.safe_dump({"format": FORMAT, **known}, sort_keys=False))


def read(folder: Path) -> Dataset:
    """Read a dataset; raises DataError naming the file and the remedy. Damaged rows are left out."""
    if folder.is_file():
        raise DataError(f"trials={folder}: this is a file. Name the folder that holds it: {folder.parent}")
    if not folder.is_dir():
        raise DataError(f"trials={folder}: there is no such folder. Name a run's folder or one in the data format.")
    known = metadata(folder)
    rows: dict[str, Rows] = {}
    shots = _shots(folder, known, rows)
    motion_table = ARM if _find(folder, "arm") else GRASP
    motion = _read(motion_table, folder, rows)
    points, readings, masks = _seen(folder, known, rows, need_points=not shots)
    trials: dict[str, Observation] = {}
    films: dict[str, Film] = {}
    unusable: dict[str, Unusable] = {}
    names = sorted({*motion["trial"], *shots, *points["trial"]})
    moving = _moving(known, names)
    clocks = _clocks(motion)
    parts = [_by_trial(frame) for frame in (motion, points, readings, masks)]
    for name in names:
        begin = clocks.get(name, 0.0)
        own = (part.get(name, empty) for part, empty in parts)
        moved, *seen = (frame.assign(t=frame["t"] - begin) if begin else frame for frame in own)
        hand = {motion_table.name: moved}
        trial = replace(Observation(name, *seen, **hand), moving=name in moving)
        film = Film(shots[name][0] - begin, shots[name][1], **hand) if name in shots else None
        fault = _invalid(known, name) or _unusable(moved["t"].to_numpy(), motion_table.name, trial, film, begin)
        if fault:
            unusable[name] = fault
        else:
            trials[name] = trial
            films |= {name: film} if film else {}
    return Dataset(folder, trials, films, unusable, known, _hashes(folder, shots), rows, clocks)


def _clocks(motion: pd.DataFrame) -> dict[str, float]:
    """A whole second at which the hand's motion begins [s], of trials whose clock began long before them."""
    first = motion.groupby("trial")["t"].min()
    return {str(name): float(np.floor(t)) for name, t in first.items() if abs(t) > LATE}


def _seen(folder: Path, known: Mapping[str, Any], rows: dict[str, Rows], need_points: bool) -> list[pd.DataFrame]:
    """Points, readings and masks of all trials; empty what is not there, but for points that are needed."""
    points, readings, masks = (
        _read(table, folder, rows)
        if _find(folder, table.name) or (table is POINTS and need_points)
        else with_trial(table).empty()
        for table in (POINTS, READINGS, MASKS)
    )
    sigma = (known.get("noise") or {}).get("point_sigma")  # of all points, where they have none of their own
    if sigma is not None and "sigma" not in points:
        points = points.assign(sigma=float(sigma))
    return [points, readings, masks]


def _moving(known: Mapping[str, Any], names: Iterable[str]) -> set[str]:
    """Which trials begin with the string in motion: as dataset.yaml says of one, or else of all."""
    own = known.get("trials", {})
    said = {name: own.get(name, {}).get("initial", known.get("initial", "rest")) for name in names}
    return {name for name, begins in said.items() if begins == "moving"}


def _shots(folder: Path, known: Mapping[str, Any], rows: dict[str, Rows]) -> dict[str, Shots]:
    """Times and images of each trial that has any; raises DataError where points must be made of them and cannot."""
    camera = known.get("camera") or {}
    found = videos(folder)
    needed = ["px_per_m", "origin_px"] + (["fps"] if found else [])
    missing = [f"camera.{key}" for key in needed if key not in camera]
    if missing and (found or _find(folder, FRAMES.name)) and not _find(folder, POINTS.name):
        raise DataError(
            f"{folder / 'dataset.yaml'}: {', '.join(missing)} must be there to make points of frames. Add what the "
            "camera had: fps as filmed (a video may be played slower), px_per_m, and the pixel of the origin."
        )
    if _find(folder, FRAMES.name):
        return listed(folder, _read(FRAMES, folder, rows))
    return filmed(folder, float(camera["fps"])) if found and "fps" in camera else {}


def _hashes(folder: Path, shots: Mapping[str, Shots]) -> dict[str, str]:
    """SHA-256 of the content of what a dataset is made of, by path in its folder: tables, folders of frames, videos."""
    tables = (ARM, GRASP, POINTS, READINGS, MASKS, FRAMES)
    found = {path for table in tables if (path := _find(folder, table.name))} | set(videos(folder))
    stills = (images.files for _, images in shots.values() if isinstance(images, ImageFiles))
    found |= {(folder / file).parent for files in stills for file in files}
    return {path.relative_to(folder).as_posix(): content_hash(path) for path in sorted(found)}


def _find(folder: Path, name: str) -> Path | None:
    """The file of a table, if there is one; raises DataError where it lies elsewhere."""
    found = (folder / f"{name}{end}" for end in (".parquet", ".csv"))
    return next((own(folder, path) for path in found if path.exists()), None)


def _read(table: Table, folder: Path, rows: dict[str, Rows]) -> pd.DataFrame:
    """One table in the order of time, without rows that cannot be used; what became of those goes into `rows`."""
    path = _find(folder, table.name)
    if path is None:
        instead = {POINTS: ", nor frames or videos", GRASP: ", nor arm.parquet or arm.csv"}.get(table, "")
        raise DataError(f"{folder}: neither {table.name}.parquet nor {table.name}.csv{instead}. {_instead_of(folder)}")
    whole = with_trial(table)
    frame = from_csv(whole, path) if path.suffix == ".csv" else read_table(whole, path)
    _check_names(frame["trial"].unique(), path)
    if table in (READINGS, MASKS):  # of these NaN is a value
        return frame.sort_values(["trial", "t"], kind="stable").reset_index(drop=True)
    if table is FRAMES:
        frame = frame.assign(file=_in_the_folder(frame["file"], folder, path))
    kept, rows[path.name] = cleaned(whole, frame)
    return kept.reset_index(drop=True)


def _instead_of(folder: Path) -> str:
    """The remedy where a table is missing: files of other names may hold it."""
    known = {f"{table.name}{end}" for table in (ARM, GRASP, *PUBLISHED) for end in (".parquet", ".csv")}
    others = [p for p in sorted(folder.iterdir()) if p.suffix in (".csv", ".parquet", ".tsv", ".h5", ".mcap")]
    named = [str(path) for path in others if path.name not in known]
    inner = next((path.parent for path in sorted(folder.glob(f"*/{NAME}"))), None)
    if inner is not None:
        return f"A dataset lies in {inner}. Name that folder"
    if not named:
        return "Add it, with column 'trial'."
    files = " ".join(map(shlex.quote, named[:4])) + " ..." * (len(named) > 4)
    return f"If other files hold it: python -m pipeline import {files} --to {shlex.quote(f'{folder}-imported')}"


def _check_names(names: Sequence[Any], path: Path) -> None:
    """Refuse names of trials that are too many, or that would steer a terminal."""
    if len(names) > MOST_TRIALS:
        raise DataError(f"{path}: it holds {len(names)} trials, at most {MOST_TRIALS} are read. Split it.")
    for name in names:
        if not str(name).isprintable():
            raise DataError(f"{path}: the trial {str(name)!r} has a name that cannot be printed. Give it another.")


def _in_the_folder(files: pd.Series, folder: Path, path: Path) -> pd.Series:
    """Names of frames, none where there is no such file; raises DataError for one outside the folder."""
    there = files.map(lambda file: inside(folder, str(file))).astype(bool)
    outside = next((str(file) for file in files[~there].dropna() if leaves(folder, str(file))), None)
    if outside is not None:
        raise DataError(
            f"{path}: the frame '{printable(outside)}' (column file) lies outside the folder {folder}. "
            "Copy it there, and name it by its path in the folder."
        )
    return files.where(there)


def _by_trial(frame: pd.DataFrame) -> tuple[dict[str, pd.DataFrame], pd.DataFrame]:
    """The rows of each trial, by its name, and those of one that has none."""
    rows = frame.drop(columns="trial")
    parts = rows.groupby(frame["trial"], sort=False)
    return {str(name): part.reset_index(drop=True) for name, part in parts}, rows.iloc[:0].reset_index(drop=True)


def fits(data: Dataset, length: float) -> Dataset:
    """Without what lies further along than a string of `length` [m] is long: a few points, or else whole trials."""
    kept, faults = {}, {}
    for name, observation in data.trials.items():
        beyond = observation.points["s"] > BEYOND * length
        if beyond[observation.read.index].mean() > STRAY:
            far = observation.read["s"].max()
            reason = f"points up to s = {far:.3f} m on a string of {length:.3f} m (string.length)"
            faults[name] = Unusable(reason, "Correct s or string.length", POINTS.name, "s")
        else:
            kept[name] = replace(observation, points=observation.points[~beyond].reset_index(drop=True))
    return replace(data, trials=kept, unusable={**data.unusable, **faults})


def _invalid(known: Mapping[str, Any], name: str) -> Unusable | None:
    """Why dataset.yaml says that a trial is not to be used, if it does."""
    reason = known.get("trials", {}).get(name, {}).get("invalid")
    remedy = f"Take 'invalid' out of {NAME} if it should count"
    return Unusable(str(reason), remedy, NAME, f"trials.{name}.invalid") if reason else None


def _unusable(moved: np.ndarray, table: str, trial: Observation, film: Film | None, begin: float) -> Unusable | None:
    """Why a trial cannot be used, whose hand was seen at these times [s] by a table; None if it can. begin: what was
    taken from all of its times [s]."""
    if not len(moved):
        named = "Add its rows to the arm's or the grasp's table, or see that its name is the same in both"
        return Unusable("no motion of the hand", named, table, TRIAL.name)
    seen, where = np.unique(trial.read["t"]), POINTS.name
    if not len(seen):
        if film is None:
            return _pointless(trial)
        seen, where = film.t, FRAMES.name
    if len(seen) < FRAMES_NEEDED:
        reason = f"the string was seen in {len(seen)} frame(s) only"
        return Unusable(reason, "A motion takes more frames: record it again", where, "t")
    common = min(moved.max(), seen.max()) - max(moved.min(), seen.min())
    if common >= OVERLAP:
        return None
    reason = f"arm and camera overlap for {max(common, 0):.2f} s only{_two_clocks(moved + begin, seen + begin)}"
    remedy = "See that both clocks begin together and that both count seconds; `import` lays them over one another"
    return Unusable(reason, remedy, where, "t")


def _two_clocks(moved: np.ndarray, seen: np.ndarray) -> str:
    """A description of two clocks that have no time in common. moved, seen: times of arm and camera [s]."""
    said = [
        f"says {datetime.fromtimestamp(t.min(), UTC):%Y-%m-%d %H:%M:%S} (seconds since 1970)"
        if SINCE_1970[0] < t.min() < SINCE_1970[1]
        else f"goes from {t.min():.2f} to {t.max():.2f} s"
        for t in (moved, seen)
    ]
    return f": the arm's clock {said[0]}, the camera's {said[1]}"


def _pointless(trial: Observation) -> Unusable:
    """The reason why a trial without a valid point and without frames is unusable."""
    if trial.points.empty:
        named = "Add its rows to points or frames, or see that its name is the same in both"
        return Unusable("no measured point and no frame", named, POINTS.name, TRIAL.name)
    return Unusable(
        "no measured point is valid", "Look at 'valid' in its points: a blank is false", POINTS.name, "valid"
    )
