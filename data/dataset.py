"""Folders of measured data, by this program or others (`data/README.md`).

A dataset is one folder: `arm` or `grasp`, and `points`, each as Parquet or CSV with the
leading column `trial`, and `dataset.yaml`. Where points are yet to be made there are
frames instead, listed in `frames`, or a video for each trial. A run of ours also keeps
`readings` and `masks`, so that estimation from disk sees exactly what it saw in the
run.
"""

from __future__ import annotations

import shlex
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
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
from stringcast.data.errors import escape_control_characters
from stringcast.data.file_checks import (
    is_file_inside,
    is_outside,
    mark_yaml_end,
    require_inside,
)
from stringcast.data.images import ImageFiles, TimedImages, Video, video_files
from stringcast.data.metadata import DATASET_FILE, FORMAT_VERSION, read_metadata
from stringcast.data.rows import RowCounts, clean_rows, read_csv_table
from stringcast.data.schema import Column, DataError, Table
from stringcast.data.store import (
    DIGEST_COLUMN,
    content_hash,
    read_table,
    write_table,
    write_text,
)

TRIAL_COLUMN = Column("trial", "", "name of the trial", "text")
RUN_TABLES = (ARM, FRAMES, POINTS, READINGS, MASKS)  # of trials of ours
# lengths of the string: points farther along are another string's
MAX_ARC_LENGTH_RATIO = 1.05
# of a trial's points: so few that lie beyond are dropped, not the trial
MAX_STRAY_FRACTION = 0.05
UNIX_TIME_RANGE_S = (1e9, 4e9)  # [s]: 2001 to 2096
MIN_OVERLAP_S = 0.1  # [s] that arm and camera must have in common
MIN_FRAMES = 3  # in which the string was seen
MAX_TRIALS = 4000  # each takes a millisecond to separate, and seconds to simulate once
# [s] of a trial's first time: larger times are counted from a whole second of the trial
MAX_FIRST_TIME_S = 10.0
ENDINGS = (".parquet", ".csv")


def with_trial(table: Table) -> Table:
    """Add the leading column `trial` to a table's schema."""
    return Table(table.name, table.meaning, (TRIAL_COLUMN, *table.columns))


@dataclass(frozen=True)
class TrialFault:
    """The reason why a trial cannot be used.

    file: dataset.yaml, or the name of the table with the fault. field: key or column
    there.
    """

    reason: str
    remedy: str
    file: str
    field: str


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
        Why other trials cannot be used, by name.
    metadata
        The content of dataset.yaml.
    hashes
        Hashes of every file that was read, by name.
    row_counts
        Counts of the rows of the measured tables, by file.
    clock_starts
        Seconds subtracted from the times of a trial whose clock began long before it,
        by trial.
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
        """Reasons of trials that cannot be used, by name."""
        return {name: fault.reason for name, fault in self.unusable.items()}

    def require_trial(self, place: str) -> None:
        """Raise DataError, which begins with the place, if no trial can be used."""
        if not self.trials:
            reasons = describe_rejected(self.rejection_reasons) or "it holds no trial"
            raise DataError(
                f"{place}: no trial can be used ({reasons}). "
                "Look at the files it names."
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
    """Write trials of ours as a dataset.

    Each file is replaced whole, `dataset.yaml` last.

    Parameters
    ----------
    folder
        The folder of the dataset.
    trials
        Trials and their points by name.
    trial_folders
        The folder of each trial's frames, relative to `folder`.
    metadata
        The content of dataset.yaml, without the format.
    origin
        What made the trials; it goes into every footer.
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
    """Read a dataset, without damaged rows.

    Parameters
    ----------
    folder
        A run's folder, or one in the data format.

    Returns
    -------
    Dataset
        All trials, with the reasons why some cannot be used.

    Raises
    ------
    DataError
        If a file is missing or damaged; it names the file and the remedy.
    """
    if folder.is_file():
        raise DataError(
            f"trials={folder}: this is a file. "
            f"Name the folder that holds it: {folder.parent}"
        )
    if not folder.is_dir():
        raise DataError(
            f"trials={folder}: there is no such folder. "
            "Name a run's folder or one in the data format."
        )
    # the tables of all trials together
    metadata = read_metadata(folder)
    row_counts: dict[str, RowCounts] = {}
    footage = _read_footage(folder, metadata, row_counts)
    hand, tables = _read_tables(folder, metadata, row_counts, filmed=bool(footage))
    # each trial by itself, by a clock of its own, and whether it can be used
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
        fault = _find_timeless_fault(name, row_counts)
        fault = fault or _find_fault(trial, film, hand, block, start)
        if fault is not None:
            unusable[name] = fault
        else:
            trials[name] = trial
            if film is not None:
                films[name] = film
        if start:
            clock_starts[name] = start
    # by these a run knows whether the data have changed since
    hashes = {
        path.relative_to(folder).as_posix(): content_hash(path)
        for path in _source_files(folder, footage)
    }
    return Dataset(
        folder, trials, films, unusable, metadata, hashes, row_counts, clock_starts
    )


def _source_files(folder: Path, footage: Mapping[str, TimedImages]) -> list[Path]:
    """List what a dataset consists of: tables, folders of frames, videos."""
    paths = set(video_files(folder))
    for table in (GRASP, *RUN_TABLES):
        path = _find_table(folder, table.name)
        if path is not None:
            paths.add(path)
    for _, images in footage.values():
        if isinstance(images, ImageFiles):
            paths |= {(folder / file).parent for file in images.files}
    return sorted(paths)


class MeasuredTables(NamedTuple):
    """Rows of all trials, or of one, of each measured table."""

    motion: pd.DataFrame
    points: pd.DataFrame
    readings: pd.DataFrame
    masks: pd.DataFrame


def _read_tables(
    folder: Path,
    metadata: Mapping[str, Any],
    row_counts: dict[str, RowCounts],
    filmed: bool,
) -> tuple[Table, MeasuredTables]:
    """Read the schema of the hand's motion, ARM or GRASP, and the tables of all trials.

    Points may be missing if frames were filmed.
    """
    hand = ARM if _find_table(folder, ARM.name) else GRASP
    motion = _read_table(hand, folder, row_counts)
    frames = []
    for table in (POINTS, READINGS, MASKS):
        is_needed = table is POINTS and not filmed
        if is_needed or _find_table(folder, table.name) is not None:
            frames.append(_read_table(table, folder, row_counts))
        else:
            frames.append(with_trial(table).empty())
    points, readings, masks = frames
    sigma = (metadata.get("noise") or {}).get("point_sigma")
    if sigma is not None and "sigma" not in points:
        points = points.assign(sigma=float(sigma))
    return hand, MeasuredTables(motion, points, readings, masks)


def _build_trial(
    name: str,
    hand: Table,
    tables: MeasuredTables,
    footage: TimedImages | None,
    moving: bool,
) -> tuple[Observation, Film | None, float]:
    """Build a trial, its film if any, and what was subtracted from all its times [s].

    hand: schema of the motion.
    """
    first = tables.motion["t"].min()
    start = float(np.floor(first)) if abs(first) > MAX_FIRST_TIME_S else 0.0
    if start:
        tables = MeasuredTables(*(rows.assign(t=rows["t"] - start) for rows in tables))
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
    folder: Path, metadata: Mapping[str, Any], row_counts: dict[str, RowCounts]
) -> dict[str, TimedImages]:
    """Read times and images of each trial that has any.

    Raises DataError if points must be made of them and the camera is not described.
    """
    camera = metadata.get("camera") or {}
    films = video_files(folder)
    has_frames = _find_table(folder, FRAMES.name) is not None
    needed = ["px_per_m", "origin_px"]
    if films:
        needed.append("fps")
    missing = [f"camera.{key}" for key in needed if key not in camera]
    if missing and (films or has_frames) and not _find_table(folder, POINTS.name):
        raise DataError(
            f"{folder / 'dataset.yaml'}: {', '.join(missing)} must be there to make "
            "points of frames. Add what the camera had: fps as filmed (a video may be "
            "played slower), px_per_m, and the pixel of the origin."
        )
    footage: dict[str, TimedImages] = {}
    if has_frames:
        for name, rows in _read_table(FRAMES, folder, row_counts).groupby("trial"):
            images = ImageFiles(folder, tuple(rows["file"]))
            footage[str(name)] = rows["t"].to_numpy(), images
    elif "fps" in camera:
        for path in films:
            video = Video(path)
            # the rate as filmed, not as played
            footage[path.stem] = video.frame_times(float(camera["fps"])), video
    return footage


def _find_table(folder: Path, name: str) -> Path | None:
    """Find the file of a table, if there is one.

    Raises DataError if it is a link to somewhere else.
    """
    for ending in ENDINGS:
        path = folder / f"{name}{ending}"
        if path.exists():
            return require_inside(folder, path)
    return None


def _read_table(
    table: Table, folder: Path, row_counts: dict[str, RowCounts]
) -> pd.DataFrame:
    """Read one table in the order of time, without unusable rows.

    The counts of dropped rows go into `row_counts`.
    """
    path = _find_table(folder, table.name)
    if path is None:
        alternative = {
            POINTS: ", nor frames or videos",
            GRASP: ", nor arm.parquet or arm.csv",
        }.get(table, "")
        raise DataError(
            f"{folder}: neither {table.name}.parquet nor "
            f"{table.name}.csv{alternative}. {_missing_table_remedy(folder)}"
        )
    schema = with_trial(table)
    frame = (
        read_csv_table(schema, path)
        if path.suffix == ".csv"
        else read_table(schema, path)
    )
    names = frame["trial"].unique()
    if len(names) > MAX_TRIALS:
        raise DataError(
            f"{path}: it holds {len(names)} trials, at most {MAX_TRIALS} are read. "
            "Split it."
        )
    for name in names:  # one that cannot be printed would steer a terminal
        if not str(name).isprintable():
            raise DataError(
                f"{path}: the trial {str(name)!r} has a name that cannot be printed. "
                "Give it another."
            )
    if table in (READINGS, MASKS):  # NaN is a value in these
        frame = frame.sort_values(["trial", "t"], kind="stable")
        return frame.reset_index(drop=True)
    if table is FRAMES:
        frame = frame.assign(file=_frame_files(frame["file"], folder, path))
        if DIGEST_COLUMN in frame:  # trials whose frames were not kept have no film
            count = frame.groupby("trial")["file"].transform("count")
            is_kept = (count > 0) | frame[DIGEST_COLUMN].isna()
            frame = frame[is_kept]
            if len(is_kept) and frame.empty:
                return frame
    frame, row_counts[path.name] = clean_rows(schema, frame)
    return frame.reset_index(drop=True)


def _frame_files(files: pd.Series, folder: Path, path: Path) -> pd.Series:
    """Replace missing files of frames by NaN, and refuse one outside the folder.

    A missing file is one frame lost; a file elsewhere is not ours to show.
    """
    exists = files.map(lambda file: is_file_inside(folder, str(file))).astype(bool)
    for file in files[~exists].dropna():
        if is_outside(folder, str(file)):
            raise DataError(
                f"{path}: the frame '{escape_control_characters(str(file))}' "
                f"(column file) lies outside the folder {folder}. "
                "Copy it there, and name it by its path in the folder."
            )
    return files.where(exists)


def _missing_table_remedy(folder: Path) -> str:
    """Write the remedy for a missing table: files of other names may hold it."""
    inner = sorted(folder.glob(f"*/{DATASET_FILE}"))
    if inner:
        return f"A dataset lies in {inner[0].parent}. Name that folder"
    own_names = {table.name for table in (GRASP, *RUN_TABLES)}
    files = []
    for path in sorted(folder.iterdir()):
        is_table = path.suffix in (*ENDINGS, ".tsv", ".h5", ".mcap")
        is_own = path.suffix in ENDINGS and path.stem in own_names
        if is_table and not is_own:
            files.append(shlex.quote(str(path)))
    if not files:
        return "Add it, with column 'trial'."
    if len(files) > 4:
        files[4:] = ["..."]
    target = shlex.quote(f"{folder}-imported")
    return (
        "If other files hold it: python -m pipeline import "
        f"{' '.join(files)} --to {target}"
    )


def _split_by_trial(frame: pd.DataFrame) -> defaultdict[str, pd.DataFrame]:
    """Split the rows by trial; a trial without rows has a frame without rows."""
    rows = frame.drop(columns="trial")
    empty = rows.iloc[:0].reset_index(drop=True)
    parts: defaultdict[str, pd.DataFrame] = defaultdict(lambda: empty)
    for name, part in rows.groupby(frame["trial"], sort=False):
        parts[str(name)] = part.reset_index(drop=True)
    return parts


def exclude_stray_points(data: Dataset, length: float) -> Dataset:
    """Exclude what lies farther along than the string is long.

    Parameters
    ----------
    data
        The dataset.
    length
        Length of the string [m].

    Returns
    -------
    Dataset
        The dataset without a trial's few stray points, or without the whole trial where
        they are many.
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


def _find_timeless_fault(
    name: str, row_counts: Mapping[str, RowCounts]
) -> TrialFault | None:
    """Find times of a trial that say nothing of the single row; None if there are none.

    row_counts: of the tables by file.
    """
    for file, counts in row_counts.items():
        if name in counts.timeless:
            return TrialFault(
                counts.timeless[name],
                "They may be stored as float32, or rounded: write them with more "
                "digits, or give the rate of the rows: import --fps 200",
                file.rpartition(".")[0],
                "t",
            )
    return None


def _find_fault(
    trial: Observation,
    film: Film | None,
    hand: Table,
    block: Mapping[str, Any],
    start: float,
) -> TrialFault | None:
    """Find out why a trial cannot be used; None if it can.

    hand: schema of its motion. block: its entry in dataset.yaml. start: what was
    subtracted from all its times [s].
    """
    if block.get("invalid"):
        return TrialFault(
            str(block["invalid"]),
            f"Take 'invalid' out of {DATASET_FILE} if it should count",
            DATASET_FILE,
            f"trials.{trial.trial}.invalid",
        )
    motion = getattr(trial, hand.name)["t"].to_numpy()
    if not len(motion):
        return TrialFault(
            "no motion of the hand",
            "Add its rows to the arm's or the grasp's table, "
            "or use the same name in both",
            hand.name,
            TRIAL_COLUMN.name,
        )
    seen, table = np.unique(trial.valid_points["t"]), POINTS.name
    if not len(seen) and film is not None:
        seen, table = film.t, FRAMES.name
    elif not len(seen):
        reason, column = "no measured point is valid", "valid"
        remedy = "Look at 'valid' in its points: a blank is false"
        if trial.points.empty:
            reason, column = "no measured point and no frame", TRIAL_COLUMN.name
            remedy = "Add its rows to points or frames, or use the same name in both"
        return TrialFault(reason, remedy, table, column)
    if len(seen) < MIN_FRAMES:
        reason = f"the string was seen in {len(seen)} frame(s) only"
        remedy = "A motion takes more frames: record it again"
        return TrialFault(reason, remedy, table, "t")
    overlap = min(motion.max(), seen.max()) - max(motion.min(), seen.min())
    if overlap >= MIN_OVERLAP_S:
        return None
    return TrialFault(
        f"arm and camera overlap for {max(overlap, 0):.2f} s only: the arm's clock "
        f"{_clock_words(motion + start)}, the camera's {_clock_words(seen + start)}",
        "See that both clocks begin together and that both count seconds; "
        "`import` lays them over one another",
        table,
        "t",
    )


def _clock_words(t: np.ndarray) -> str:
    """Describe the clock of times t (K,) [s]."""
    first = t.min()
    if UNIX_TIME_RANGE_S[0] < first < UNIX_TIME_RANGE_S[1]:
        date = datetime.fromtimestamp(first, UTC)
        return f"says {date:%Y-%m-%d %H:%M:%S} (seconds since 1970)"
    return f"goes from {first:.2f} to {t.max():.2f} s"
