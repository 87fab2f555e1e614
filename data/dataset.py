"""Folders of measured data: a run of ours, or anybody's (format version 1, in
`data/README.md`).

A dataset is one folder: `arm` or `grasp`, and `points`, each as Parquet or CSV with the
leading column `trial`, and `dataset.yaml`. Where points are yet to be made there are
frames instead, listed in `frames`, or a video for each trial. A run of ours also keeps
`readings` and `masks`, so that estimation from disk sees exactly what it saw in the
run.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from stringcast.data.artifacts import (
    ARM,
    FRAMES,
    GRASP,
    MASKS,
    POINTS,
    READINGS,
    Film,
    Observation,
    Points,
    Trial,
)
from stringcast.data.errors import escape_control_characters
from stringcast.data.file_checks import is_file_inside, is_outside, require_inside
from stringcast.data.images import ImageFiles, TimedImages, Video, video_files
from stringcast.data.metadata import DATASET_FILE, FORMAT_VERSION, read_metadata
from stringcast.data.rows import RowCounts, clean_rows, read_csv_table
from stringcast.data.schema import Column, DataError, Table
from stringcast.data.store import content_hash, read_table, write_table, write_text

TRIAL_COLUMN = Column("trial", "", "name of the trial", "text")
RUN_TABLES = (ARM, FRAMES, POINTS, READINGS, MASKS)  # of trials of ours
# times the string's length: points further along are another string's
MAX_ARC_LENGTH_RATIO = 1.05
# of a trial's points: so few that lie beyond are left out, and not the trial
MAX_STRAY_FRACTION = 0.05
UNIX_TIME_RANGE_S = (1e9, 4e9)  # [s]: 2001 to 2096
MIN_OVERLAP_S = 0.1  # [s] that arm and camera must have in common
MIN_FRAMES = 3  # in which the string was seen
MAX_TRIALS = 4000  # each takes a millisecond to set apart, and seconds to simulate once
# [s] from which a clock began long before its trial, whose times are then counted from
# a second of its own
MAX_FIRST_TIME_S = 10.0


def with_trial(table: Table) -> Table:
    """A table with the additional leading column `trial`."""
    return Table(table.name, table.meaning, (TRIAL_COLUMN, *table.columns))


@dataclass(frozen=True)
class TrialFault:
    """Why a trial cannot be used. file: dataset.yaml, or the name of the table in which
    that is so. field: key or column there.
    """

    reason: str
    remedy: str
    file: str
    field: str


@dataclass(frozen=True)
class Dataset:
    """trials: what can be used, by name. films: their frames, where there are any.
    unusable: why the others cannot. metadata: dataset.yaml. hashes: of every file that
    was read, by name. rows: what became of the rows of the tables that were measured,
    by file. clocks: what was taken from the times of a trial [s], where its clock began
    long before it.
    """

    folder: Path
    trials: Mapping[str, Observation]
    films: Mapping[str, Film]
    unusable: Mapping[str, TrialFault]
    metadata: Mapping[str, Any]
    hashes: Mapping[str, str]
    row_counts: Mapping[str, RowCounts] = field(default_factory=dict)
    clock_starts: Mapping[str, float] = field(default_factory=dict)

    @property
    def rejection_reasons(self) -> dict[str, str]:
        """The reasons of trials that cannot be used, by name."""
        return {name: fault.reason for name, fault in self.unusable.items()}


def write_dataset(
    folder: Path,
    trials: Mapping[str, tuple[Trial, Points]],
    places: Mapping[str, Path],
    known: Mapping[str, Any],
    origin: Mapping[str, Any],
) -> None:
    """Write trials of ours as a dataset; each file is replaced whole, `dataset.yaml`
    last.

    places: the folder of each trial's frames, relative to `folder`. known: what
    dataset.yaml says beside the format. origin: goes into every footer.
    """
    frames = {name: trial.frames for name, (trial, _) in trials.items()}
    files = {
        name: [(places[name] / file).as_posix() for file in frame["file"]]
        for name, frame in frames.items()
    }
    tables = {
        ARM: {name: trial.arm for name, (trial, _) in trials.items()},
        FRAMES: {
            name: frame.assign(file=files[name]) for name, frame in frames.items()
        },
        POINTS: {name: points.points for name, (_, points) in trials.items()},
        READINGS: {name: points.readings for name, (_, points) in trials.items()},
        MASKS: {name: points.masks for name, (_, points) in trials.items()},
    }
    for table, parts in tables.items():
        whole = pd.concat(
            [part.assign(trial=name) for name, part in parts.items()], ignore_index=True
        )
        write_table(with_trial(table), whole, folder / f"{table.name}.parquet", origin)
    write_text(
        folder / DATASET_FILE,
        yaml.safe_dump({"format": FORMAT_VERSION, **known}, sort_keys=False),
    )


def read_dataset(folder: Path) -> Dataset:
    """Read a dataset; raises DataError naming the file and the remedy. Damaged rows are
    left out.
    """
    if folder.is_file():
        raise DataError(
            f"trials={folder}: this is a file. Name the folder that holds it: {folder.parent}"
        )
    if not folder.is_dir():
        raise DataError(
            f"trials={folder}: there is no such folder. Name a run's folder or one in the data format."
        )
    # the tables of all trials together
    known = read_metadata(folder)
    rows: dict[str, RowCounts] = {}
    shots = _read_footage(folder, known, rows)
    hand, frames = _read_tables(folder, known, rows, filmed=bool(shots))
    # each trial apart, by a clock of its own, and whether it can be used
    parts = [_split_by_trial(frame) for frame in frames]
    trials: dict[str, Observation] = {}
    films: dict[str, Film] = {}
    unusable: dict[str, TrialFault] = {}
    clocks: dict[str, float] = {}
    for name in sorted({*frames[0]["trial"], *frames[1]["trial"], *shots}):
        about = known.get("trials", {}).get(name, {})
        begins = about.get("initial", known.get("initial", "rest"))
        own = [part.get(name, empty) for part, empty in parts]
        trial, film, begin = _build_trial(
            name, hand, own, shots.get(name), moving=begins == "moving"
        )
        if fault := _find_fault(trial, film, hand, about, begin):
            unusable[name] = fault
        else:
            trials[name] = trial
            films |= {name: film} if film else {}
        clocks |= {name: begin} if begin else {}
    # the content of all that was read, by which a run knows whether the data have
    # changed since
    sources = {
        path.relative_to(folder).as_posix(): content_hash(path)
        for path in _source_files(folder, shots)
    }
    return Dataset(folder, trials, films, unusable, known, sources, rows, clocks)


def _source_files(folder: Path, shots: Mapping[str, TimedImages]) -> list[Path]:
    """What a dataset is made of: tables, folders of frames, videos."""
    tables = (ARM, GRASP, POINTS, READINGS, MASKS, FRAMES)
    found = {
        path for table in tables if (path := _find_table(folder, table.name))
    } | set(video_files(folder))
    stills = (
        images.files for _, images in shots.values() if isinstance(images, ImageFiles)
    )
    return sorted(
        found | {(folder / file).parent for files in stills for file in files}
    )


def _read_tables(
    folder: Path, known: Mapping[str, Any], rows: dict[str, RowCounts], filmed: bool
) -> tuple[Table, list[pd.DataFrame]]:
    """Which table the hand's motion is in, and of all trials motion, points, readings
    and masks.

    filmed: there are frames of which points can be made, so that no table of points is
    needed.
    """
    hand = ARM if _find_table(folder, ARM.name) else GRASP
    frames = [_read_table(hand, folder, rows)]
    for table in (POINTS, READINGS, MASKS):
        needed = table is POINTS and not filmed
        there = needed or _find_table(folder, table.name) is not None
        frames.append(
            _read_table(table, folder, rows) if there else with_trial(table).empty()
        )
    # of all points, where they have none of their own
    sigma = (known.get("noise") or {}).get("point_sigma")
    if sigma is not None and "sigma" not in frames[1]:
        frames[1] = frames[1].assign(sigma=float(sigma))
    return hand, frames


def _build_trial(
    name: str,
    hand: Table,
    own: Sequence[pd.DataFrame],
    shots: TimedImages | None,
    moving: bool,
) -> tuple[Observation, Film | None, float]:
    """A trial, its frames where there are any, and what was taken from all of its times
    [s].

    hand: the table that the first of `own` is of; the others are its points, readings
    and masks. moving: see `Observation`.
    """
    first = own[0]["t"].min()
    begin = float(np.floor(first)) if abs(first) > MAX_FIRST_TIME_S else 0.0
    moved, *seen = (
        frame.assign(t=frame["t"] - begin) if begin else frame for frame in own
    )
    motion = {hand.name: moved}
    trial = replace(Observation(name, *seen, **motion), starts_moving=moving)
    return trial, Film(shots[0] - begin, shots[1], **motion) if shots else None, begin


def _read_footage(
    folder: Path, known: Mapping[str, Any], rows: dict[str, RowCounts]
) -> dict[str, TimedImages]:
    """Times and images of each trial that has any; raises DataError where points must
    be made of them and cannot.
    """
    camera = known.get("camera") or {}
    found = video_files(folder)
    needed = ["px_per_m", "origin_px"] + (["fps"] if found else [])
    missing = [f"camera.{key}" for key in needed if key not in camera]
    if (
        missing
        and (found or _find_table(folder, FRAMES.name))
        and not _find_table(folder, POINTS.name)
    ):
        raise DataError(
            f"{folder / 'dataset.yaml'}: {', '.join(missing)} must be there to make points of frames. Add what the "
            "camera had: fps as filmed (a video may be played slower), px_per_m, and the pixel of the origin."
        )
    if _find_table(folder, FRAMES.name):
        frames = _read_table(FRAMES, folder, rows).groupby("trial")
        return {
            str(name): (one["t"].to_numpy(), ImageFiles(folder, tuple(one["file"])))
            for name, one in frames
        }
    shots: dict[str, TimedImages] = {}
    for path in found if "fps" in camera else ():  # as filmed, not as played
        video = Video(path)
        shots[path.stem] = np.arange(len(video)) / float(camera["fps"]), video
    return shots


def _find_table(folder: Path, name: str) -> Path | None:
    """The file of a table, if there is one; raises DataError where it lies elsewhere."""
    found = (folder / f"{name}{end}" for end in (".parquet", ".csv"))
    return next((require_inside(folder, path) for path in found if path.exists()), None)


def _read_table(table: Table, folder: Path, rows: dict[str, RowCounts]) -> pd.DataFrame:
    """One table in the order of time, without rows that cannot be used; what became of
    those goes into `rows`.
    """
    path = _find_table(folder, table.name)
    if path is None:
        instead = {
            POINTS: ", nor frames or videos",
            GRASP: ", nor arm.parquet or arm.csv",
        }.get(table, "")
        raise DataError(
            f"{folder}: neither {table.name}.parquet nor {table.name}.csv{instead}. {_missing_table_remedy(folder)}"
        )
    whole = with_trial(table)
    frame = (
        read_csv_table(whole, path)
        if path.suffix == ".csv"
        else read_table(whole, path)
    )
    names = frame["trial"].unique()
    if len(names) > MAX_TRIALS:
        raise DataError(
            f"{path}: it holds {len(names)} trials, at most {MAX_TRIALS} are read. Split it."
        )
    for name in names:  # one that cannot be printed would steer a terminal
        if not str(name).isprintable():
            raise DataError(
                f"{path}: the trial {str(name)!r} has a name that cannot be printed. Give it another."
            )
    if table in (READINGS, MASKS):  # of these NaN is a value
        return frame.sort_values(["trial", "t"], kind="stable").reset_index(drop=True)
    # a file that is not there is one frame lost, one outside the folder is another's to
    # show
    if table is FRAMES:
        there = (
            frame["file"]
            .map(lambda file: is_file_inside(folder, str(file)))
            .astype(bool)
        )
        outside = next(
            (
                str(file)
                for file in frame["file"][~there].dropna()
                if is_outside(folder, str(file))
            ),
            None,
        )
        if outside is not None:
            raise DataError(
                f"{path}: the frame '{escape_control_characters(outside)}' (column file) lies outside the folder {folder}. "
                "Copy it there, and name it by its path in the folder."
            )
        frame = frame.assign(file=frame["file"].where(there))
    kept, rows[path.name] = clean_rows(whole, frame)
    return kept.reset_index(drop=True)


def _missing_table_remedy(folder: Path) -> str:
    """The remedy where a table is missing: files of other names may hold it."""
    known = {
        f"{table.name}{end}"
        for table in (ARM, GRASP, *RUN_TABLES)
        for end in (".parquet", ".csv")
    }
    others = [
        p
        for p in sorted(folder.iterdir())
        if p.suffix in (".csv", ".parquet", ".tsv", ".h5", ".mcap")
    ]
    named = [str(path) for path in others if path.name not in known]
    inner = next(
        (path.parent for path in sorted(folder.glob(f"*/{DATASET_FILE}"))), None
    )
    if inner is not None:
        return f"A dataset lies in {inner}. Name that folder"
    if not named:
        return "Add it, with column 'trial'."
    files = " ".join(map(shlex.quote, named[:4])) + " ..." * (len(named) > 4)
    return f"If other files hold it: python -m pipeline import {files} --to {shlex.quote(f'{folder}-imported')}"


def _split_by_trial(
    frame: pd.DataFrame,
) -> tuple[dict[str, pd.DataFrame], pd.DataFrame]:
    """The rows of each trial, by its name, and those of one that has none."""
    rows = frame.drop(columns="trial")
    parts = rows.groupby(frame["trial"], sort=False)
    return {str(name): part.reset_index(drop=True) for name, part in parts}, rows.iloc[
        :0
    ].reset_index(drop=True)


def exclude_stray_points(data: Dataset, length: float) -> Dataset:
    """Without what lies further along than a string of `length` [m] is long: a few
    points, or else whole trials.
    """
    kept, faults = {}, {}
    for name, observation in data.trials.items():
        beyond = observation.points["s"] > MAX_ARC_LENGTH_RATIO * length
        if beyond[observation.valid_points.index].mean() > MAX_STRAY_FRACTION:
            far = observation.valid_points["s"].max()
            reason = f"points up to s = {far:.3f} m on a string of {length:.3f} m (string.length)"
            faults[name] = TrialFault(
                reason, "Correct s or string.length", POINTS.name, "s"
            )
        else:
            kept[name] = replace(
                observation, points=observation.points[~beyond].reset_index(drop=True)
            )
    return replace(data, trials=kept, unusable={**data.unusable, **faults})


def _find_fault(
    trial: Observation,
    film: Film | None,
    hand: Table,
    about: Mapping[str, Any],
    begin: float,
) -> TrialFault | None:
    """Why a trial cannot be used; None if it can.

    hand: the table of its motion. about: what dataset.yaml says of it. begin: what was
    taken from all of its times [s].
    """
    moved = getattr(trial, hand.name)["t"].to_numpy()
    if about.get("invalid"):
        remedy = f"Take 'invalid' out of {DATASET_FILE} if it should count"
        return TrialFault(
            str(about["invalid"]), remedy, DATASET_FILE, f"trials.{trial.trial}.invalid"
        )
    if not len(moved):
        named = "Add its rows to the arm's or the grasp's table, or see that its name is the same in both"
        return TrialFault("no motion of the hand", named, hand.name, TRIAL_COLUMN.name)
    seen, where = np.unique(trial.valid_points["t"]), POINTS.name
    if not len(seen) and film is not None:
        seen, where = film.t, FRAMES.name
    elif not len(seen):
        named = (
            "Add its rows to points or frames, or see that its name is the same in both"
        )
        nothing = TrialFault(
            "no measured point and no frame", named, where, TRIAL_COLUMN.name
        )
        blank = TrialFault(
            "no measured point is valid",
            "Look at 'valid' in its points: a blank is false",
            where,
            "valid",
        )
        return nothing if trial.points.empty else blank
    if len(seen) < MIN_FRAMES:
        reason = f"the string was seen in {len(seen)} frame(s) only"
        return TrialFault(
            reason, "A motion takes more frames: record it again", where, "t"
        )
    common = min(moved.max(), seen.max()) - max(moved.min(), seen.min())
    if common >= MIN_OVERLAP_S:
        return None
    reason = f"arm and camera overlap for {max(common, 0):.2f} s only{_describe_clocks(moved + begin, seen + begin)}"
    remedy = "See that both clocks begin together and that both count seconds; `import` lays them over one another"
    return TrialFault(reason, remedy, where, "t")


def _describe_clocks(moved: np.ndarray, seen: np.ndarray) -> str:
    """A description of two clocks that have no time in common. moved, seen: times of
    arm and camera [s].
    """
    said = [
        f"says {datetime.fromtimestamp(t.min(), UTC):%Y-%m-%d %H:%M:%S} (seconds since 1970)"
        if UNIX_TIME_RANGE_S[0] < t.min() < UNIX_TIME_RANGE_S[1]
        else f"goes from {t.min():.2f} to {t.max():.2f} s"
        for t in (moved, seen)
    ]
    return f": the arm's clock {said[0]}, the camera's {said[1]}"
