"""Folders of measured data, by this program or others (`data/README.md`).

A dataset is one folder: `arm` or `grasp`, and `points`, each as Parquet or CSV with the
leading column `trial`, and `dataset.yaml`. A dataset without points has frames, listed
in `frames`, or a video for each trial. A run also stores `readings` and `masks`, so
that estimation from disk gets the same input as in the run.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

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
from stringcast.data.file_checks import mark_yaml_end
from stringcast.data.images import ImageFiles, TimedImages, Video, video_files
from stringcast.data.metadata import DATASET_FILE, FORMAT_VERSION, read_metadata
from stringcast.data.rows import RowCounts
from stringcast.data.schema import DataError, Table
from stringcast.data.store import content_hash, write_table, write_text
from stringcast.data.table_files import (
    RUN_TABLES,
    TableRows,
    find_table,
    read_rows,
    with_trial,
)
from stringcast.data.trial_faults import TrialFault, find_fault, find_timeless_fault

# string lengths; points farther along belong to another string
MAX_ARC_LENGTH_RATIO = 1.05
# share of points beyond the end up to which the trial is kept
MAX_STRAY_FRACTION = 0.05
# [s]: trials that begin later are shifted by a whole number of seconds
MAX_FIRST_TIME_S = 10.0


@dataclass(frozen=True)
class Dataset:
    """The content of a folder of measured data.

    Attributes
    ----------
    folder
        The folder.
    trials
        The usable trials by name.
    films
        Frames by trial, where there are any.
    unusable
        Faults of the other trials, by name.
    metadata
        The content of dataset.yaml.
    hashes
        Hashes of every file that was read, by name.
    row_counts
        Counts of the rows of the measured tables, by file.
    clock_starts
        Seconds subtracted from times that begin far from 0, by trial.
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
        """Reasons why trials cannot be used, by name."""
        return {name: fault.reason for name, fault in self.unusable.items()}

    @property
    def held_out(self) -> tuple[str, ...]:
        """Names of the trials that are used only to measure the gain."""
        blocks = self.metadata.get("trials", {}).items()
        return tuple(name for name, block in blocks if block.get("role") == "held_out")

    def require_trial(self, place: str) -> None:
        """Raise DataError if no trial can be used; its message begins with `place`."""
        if not self.trials:
            reasons = describe_rejected(self.rejection_reasons) or "it holds no trial"
            raise DataError(
                place,
                f"no trial can be used ({reasons})",
                "Look at the files it names.",
            )


def describe_rejected(rejected: Mapping[str, str]) -> str:
    """List the rejected trials with their reasons."""
    return "; ".join(f"{name}: {reason}" for name, reason in rejected.items())


def write_dataset(
    folder: Path,
    trials: Mapping[str, tuple[Trial, Points]],
    trial_folders: Mapping[str, Path],
    metadata: Mapping[str, Any],
    origin: Mapping[str, Any],
) -> None:
    """Write trials of a run, with their points, as a dataset.

    Each file is replaced whole, `dataset.yaml` last. `trial_folders` are the folders of
    the frames, relative to `folder`. `metadata` is the content of dataset.yaml without
    the format. `origin` is written to every footer.
    """
    parts: dict[Table, list[pd.DataFrame]] = {table: [] for table in RUN_TABLES}
    for name, (trial, points) in trials.items():
        trial_folder = trial_folders[name]
        files = [(trial_folder / file).as_posix() for file in trial.frames["file"]]
        frames = trial.frames.assign(file=files)
        tables = trial.arm, frames, points.points, points.readings, points.masks
        for table, rows in zip(RUN_TABLES, tables, strict=True):
            parts[table].append(rows.assign(trial=name))
    for table, part in parts.items():
        rows = pd.concat(part, ignore_index=True)
        write_table(with_trial(table), rows, folder / f"{table.name}.parquet", origin)
    content = yaml.safe_dump({"format": FORMAT_VERSION, **metadata}, sort_keys=False)
    write_text(folder / DATASET_FILE, mark_yaml_end(content))


def read_dataset(folder: Path) -> Dataset:
    """Read a run's folder, or one in the data format, without damaged rows.

    Trials that cannot be used are listed with the reasons. Raises DataError if a file
    is missing or damaged; it names the file and the remedy.
    """
    if folder.is_file():
        raise DataError(
            f"trials={folder}",
            "this is a file",
            f"Name the folder that holds it: {folder.parent}",
        )
    if not folder.is_dir():
        raise DataError(
            f"trials={folder}",
            "there is no such folder",
            "Name a run's folder or one in the data format.",
        )
    # tables of all trials
    metadata = read_metadata(folder)
    footage, frame_counts = _read_footage(folder, metadata)
    hand, tables, counts = _read_tables(folder, metadata, is_filmed=bool(footage))
    row_counts = {**frame_counts, **counts}
    # each trial, with its own start of time, and its faults
    by_trial = [_split_by_trial(table) for table in tables]
    trials = {}
    films = {}
    unusable = {}
    clock_starts: dict[str, float] = {}
    for name in sorted({*tables.motion["trial"], *tables.points["trial"], *footage}):
        block = metadata.get("trials", {}).get(name, {})
        initial = block.get("initial", metadata.get("initial", "rest"))
        trial, film, start = _build_trial(
            name,
            hand,
            MeasuredTables(*(rows[name] for rows in by_trial)),
            footage.get(name),
            moving=initial == "moving",
        )
        fault = find_timeless_fault(name, row_counts)
        fault = fault or find_fault(trial, film, hand, block, start)
        if fault is not None:
            unusable[name] = fault
        else:
            trials[name] = trial
            if film is not None:
                films[name] = film
        if start:
            clock_starts[name] = start
    # a run compares these to notice changed data
    hashes = {
        path.relative_to(folder).as_posix(): content_hash(path)
        for path in _source_files(folder, footage)
    }
    return Dataset(
        folder, trials, films, unusable, metadata, hashes, row_counts, clock_starts
    )


def _source_files(folder: Path, footage: Mapping[str, TimedImages]) -> list[Path]:
    """List the files of a dataset: tables, folders of frames, videos."""
    paths = set(video_files(folder))
    for table in (GRASP, *RUN_TABLES):
        path = find_table(folder, table.name)
        if path is not None:
            paths.add(path)
    for _, images in footage.values():
        if isinstance(images, ImageFiles):
            paths |= {(folder / file).parent for file in images.files}
    return sorted(paths)


class MeasuredTables(NamedTuple):
    """Rows of each measured table, for one trial or all."""

    motion: pd.DataFrame
    points: pd.DataFrame
    readings: pd.DataFrame
    masks: pd.DataFrame

    def with_times_from(self, start: float) -> MeasuredTables:
        """Subtract a start time [s] from all times."""
        return MeasuredTables(*(rows.assign(t=rows["t"] - start) for rows in self))


def _read_tables(
    folder: Path, metadata: Mapping[str, Any], is_filmed: bool
) -> tuple[Table, MeasuredTables, dict[str, RowCounts]]:
    """Read the tables of all trials.

    Points may be missing if frames were filmed. Returns the schema ARM or GRASP of the
    hand, the tables, and the counts of their rows by file.
    """
    hand = ARM if find_table(folder, ARM.name) else GRASP
    frames = []
    counts: dict[str, RowCounts] = {}
    for table in (hand, POINTS, READINGS, MASKS):
        is_needed = table is hand or (table is POINTS and not is_filmed)
        rows = TableRows(with_trial(table).empty())
        if is_needed or find_table(folder, table.name) is not None:
            rows = read_rows(table, folder)
        frames.append(rows.frame)
        counts |= rows.counts
    motion, points, readings, masks = frames
    sigma = (metadata.get("noise") or {}).get("point_sigma")
    if sigma is not None and "sigma" not in points:
        points = points.assign(sigma=float(sigma))
    return hand, MeasuredTables(motion, points, readings, masks), counts


def _build_trial(
    name: str,
    hand: Table,
    tables: MeasuredTables,
    footage: TimedImages | None,
    moving: bool,
) -> tuple[Observation, Film | None, float]:
    """Build a trial, its film if any, and the start subtracted from its times [s].

    hand: schema of the motion.
    """
    first = tables.motion["t"].min()
    start = float(np.floor(first)) if abs(first) > MAX_FIRST_TIME_S else 0.0
    if start:
        tables = tables.with_times_from(start)
    motion: Any = {hand.name: tables.motion}
    trial = Observation(
        name,
        tables.points,
        tables.readings,
        tables.masks,
        **motion,
        starts_moving=moving,
    )
    if footage is None:
        return trial, None, start
    times, images = footage
    return trial, Film(times - start, images, **motion), start


def _read_footage(
    folder: Path, metadata: Mapping[str, Any]
) -> tuple[dict[str, TimedImages], Mapping[str, RowCounts]]:
    """Read times and images of each trial that has any, and counts of their rows.

    Raises DataError if points must be extracted and the camera is not described.
    """
    camera = metadata.get("camera") or {}
    films = video_files(folder)
    has_frames = find_table(folder, FRAMES.name) is not None
    needed = ["px_per_m", "origin_px"]
    if films:
        needed.append("fps")
    missing = [f"camera.{key}" for key in needed if key not in camera]
    if missing and (films or has_frames) and not find_table(folder, POINTS.name):
        raise DataError(
            folder / "dataset.yaml",
            f"{', '.join(missing)} must be there to make points of frames",
            "Add what the camera had: fps as filmed (a video may be played "
            "slower), px_per_m, and the pixel of the origin.",
        )
    footage: dict[str, TimedImages] = {}
    counts: Mapping[str, RowCounts] = {}
    if has_frames:
        frames, counts = read_rows(FRAMES, folder)
        for name, rows in frames.groupby("trial"):
            images = ImageFiles(folder, tuple(rows["file"]))
            footage[str(name)] = rows["t"].to_numpy(), images
    elif "fps" in camera:
        for path in films:
            video = Video(path)
            # frame rate of filming, not of playback
            footage[path.stem] = video.frame_times(float(camera["fps"])), video
    return footage, counts


def _split_by_trial(frame: pd.DataFrame) -> defaultdict[str, pd.DataFrame]:
    """Split rows by trial; a trial without rows gets an empty frame."""
    rows = frame.drop(columns="trial")
    empty = rows.iloc[:0].reset_index(drop=True)
    parts: defaultdict[str, pd.DataFrame] = defaultdict(lambda: empty)
    for name, part in rows.groupby(frame["trial"], sort=False):
        parts[str(name)] = part.reset_index(drop=True)
    return parts


def exclude_stray_points(data: Dataset, length: float) -> Dataset:
    """Exclude points beyond the end of a string of this length [m].

    Trials with many of them are excluded whole.
    """
    trials = {}
    faults = dict(data.unusable)
    for name, observation in data.trials.items():
        is_beyond = observation.points["s"] > MAX_ARC_LENGTH_RATIO * length
        if is_beyond[observation.valid_points.index].mean() > MAX_STRAY_FRACTION:
            farthest = observation.valid_points["s"].max()
            reason = (
                f"points up to s = {farthest:.3f} m on a string of {length:.3f} m "
                "(string.length)"
            )
            remedy = "Correct s or string.length"
            faults[name] = TrialFault(reason, remedy, POINTS.name, "s")
        else:
            points = observation.points[~is_beyond].reset_index(drop=True)
            trials[name] = replace(observation, points=points)
    return replace(data, trials=trials, unusable=faults)
