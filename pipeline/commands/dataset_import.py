"""Convert imported tables to a dataset: add arc lengths, clocks and dataset.yaml."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import yaml

from stringcast.data import disk
from stringcast.data.artifacts import ARM, GRASP, MASKS, POINTS, READINGS, Observation
from stringcast.data.file_checks import mark_yaml_end
from stringcast.data.images import Video
from stringcast.data.importers.gather import ImportedTables
from stringcast.data.metadata import DATASET_FILE, FORMAT_VERSION
from stringcast.data.schema import DataError, Table
from stringcast.data.store import content_hash, write_table
from stringcast.data.table_files import with_trial
from stringcast.data.trial_faults import MIN_OVERLAP_S
from stringcast.pipeline.commands.imported_measurements import (
    BenchHints,
    imported_grasp_poses,
    measurements_of_tables,
)
from stringcast.stages.check.clocks import SAMPLING_REMEDY, describe_sampling
from stringcast.stages.check.hanging_string import (
    HangingString,
    RestingPoints,
    find_resting_points,
    fit_hanging_string,
)
from stringcast.stages.check.measured import CheckedTrial
from stringcast.stages.clock.windows import possible_windows
from stringcast.stages.common import MM_PER_M
from stringcast.stages.report.formatting import format_count

# joints of an arm in our format; other arms are stored as hand poses
FORMAT_JOINTS = 3
MIN_FRAMES = 5  # of a trial; fewer show no motion
METADATA_HEADER = """\
# Written by `import`. All is in metres, seconds, radians and kilograms.
# What each name means: data/README.md.
"""


@dataclass(frozen=True)
class ImportedDataset:
    """A dataset before it is written.

    Attributes
    ----------
    hand_table, hand_rows
        Schema (ARM or GRASP) and rows of the hand's motion.
    points
        Rows of POINTS.
    films
        Video files by trial.
    metadata
        Content of dataset.yaml.
    notes
        Inferred properties, for people.
    added_times
        Offset that was added to the times of points, by trial [s]; empty if the times
        are as measured.
    """

    hand_table: Table
    hand_rows: pd.DataFrame
    points: pd.DataFrame
    films: Mapping[str, Path]
    metadata: dict[str, Any]
    notes: Sequence[str]
    added_times: Mapping[str, float] = field(default_factory=dict)

    @property
    def trials_without_common_time(self) -> list[str]:
        """Names of trials in which arm and camera have hardly any common time."""
        hand = self.hand_rows.groupby("trial")["t"].agg(["min", "max"])
        points = self.points.groupby("trial")["t"].agg(["min", "max"])
        names = []
        for name in sorted(hand.index.intersection(points.index)):
            start = max(hand.at[name, "min"], points.at[name, "min"])
            end = min(hand.at[name, "max"], points.at[name, "max"])
            if end - start < MIN_OVERLAP_S:
                names.append(name)
        return names


def convert_recordings(tables: ImportedTables, bench: BenchHints) -> ImportedDataset:
    """Convert recordings to a dataset.

    Raises DataError naming an option if it is needed.
    """
    grasp = imported_grasp_poses(tables, bench)
    tables = leave_out_single_frames(tables)
    located = locate_points(tables, bench)
    points, length = located.points, located.length
    notes = [*tables.notes, *located.notes]
    added_times = {}
    if bench.fit_clock:
        added_times = align_roughly(points, grasp, length)
        added = points["trial"].map(added_times).fillna(0.0)
        points = points.assign(t=points["t"] + added)

    metadata: dict[str, Any] = {"format": FORMAT_VERSION, "string": {"length": length}}
    hand_table, hand_rows = GRASP, grasp
    if len(tables.joints) == FORMAT_JOINTS:
        hand_table, hand_rows = ARM, tables.motion[["trial", "t", *tables.joints]]
        metadata["arm"] = {"links": list(bench.links), "base": list(bench.base)}
    if tables.films:
        metadata["camera"] = camera_metadata(tables)
    if bench.clock_error:
        metadata["clock"] = {"low": -bench.clock_error, "high": bench.clock_error}
    if bench.geometry_is_measured:
        metadata["geometry"] = "measured"
    if bench.starts_moving:
        metadata["initial"] = "moving"
    return ImportedDataset(
        hand_table, hand_rows, points, tables.films, metadata, notes, added_times
    )


def leave_out_single_frames(tables: ImportedTables) -> ImportedTables:
    """Drop and note the points of trials with only a few frames.

    Raises DataError if no trial is left.
    """
    if tables.points.empty:
        return tables
    frames = tables.points.groupby("trial")["t"].nunique()
    short = frames[frames < MIN_FRAMES]
    if len(short) == len(frames):
        files = {c.file.name for c in tables.used_columns if c.role.endswith("x")}
        raise DataError(
            ", ".join(sorted(files)),
            f"the string was seen in {frames.max()} frame(s) of a trial at most, "
            f"at least {MIN_FRAMES} are needed: its motion is unknown",
            "Export the tracker's whole recording.",
        )
    notes = [
        f"trial {name} is left out: the string was seen in {count} frame(s) of it"
        for name, count in short.items()
    ]
    points = tables.points[~tables.points["trial"].isin(short.index)]
    return replace(tables, points=points, notes=[*tables.notes, *notes])


def camera_metadata(tables: ImportedTables) -> dict[str, Any]:
    """Return the block `camera` for films; raise DataError for a missing option."""
    hints = tables.hints
    facts = {
        "--fps 240": hints.fps,
        "--px-per-m 340": hints.px_per_m,
        "--origin-px 251.5,387.5": hints.origin_px,
    }
    missing = [option for option, value in facts.items() if not value]
    if missing or hints.origin_px is None:
        raise DataError(
            "",
            "a film is of no use without its frame rate, scale and origin",
            f"Give those of your camera, as in {' '.join(missing)}.",
        )
    height, width = Video(next(iter(tables.films.values())))[0].shape
    return {
        "fps": hints.fps,
        "px_per_m": hints.px_per_m,
        "origin_px": list(hints.origin_px),
        "width": width,
        "height": height,
    }


class LocatedPoints(NamedTuple):
    """Points with arc lengths, and the string's length [m]; notes if inferred."""

    points: pd.DataFrame
    length: float
    notes: Sequence[str] = ()


def locate_points(tables: ImportedTables, bench: BenchHints) -> LocatedPoints:
    """Give points arc lengths: stated ones, or those of the string at rest."""
    points = tables.points
    if points.empty:
        return LocatedPoints(POINTS.empty().assign(trial=""), require_length(bench))
    refuse_unknown_points(points, bench)
    if "s" in points:
        if bench.length:
            return LocatedPoints(select_columns(points), bench.length)
        length = float(points["s"].max())
        note = describe_inferred_length(length, "the largest s")
        return LocatedPoints(select_columns(points), length, [note])
    names = points["point"].unique()
    if bench.point_arc_lengths:
        arc_lengths = bench.point_arc_lengths
        length = bench.length or max(arc_lengths.values())
        return place_points(points, arc_lengths, length)
    if len(names) == 1 and bench.length:
        return place_points(points, {names[0]: bench.length}, bench.length)
    hanging = measure_hanging_points(tables, bench)
    length = bench.length or round(hanging.length, 4)
    # to a tenth of a millimetre, within the string
    arc_lengths = {n: min(round(s, 4), length) for n, s in hanging.arc_lengths.items()}
    notes = describe_hanging_points(hanging, arc_lengths, bench)
    return place_points(points, arc_lengths, length, notes)


def place_points(
    points: pd.DataFrame,
    arc_lengths: Mapping[str, float],
    length: float,
    notes: Sequence[str] = (),
) -> LocatedPoints:
    """Keep the points of known arc length [m], with it as column s."""
    known = points[points["point"].isin(list(arc_lengths))]
    known = known.assign(s=known["point"].map(arc_lengths).astype(float))
    return LocatedPoints(select_columns(known), length, notes)


def refuse_unknown_points(points: pd.DataFrame, bench: BenchHints) -> None:
    """Refuse a stated arc length of a point that is not in the files."""
    names = list(points["point"].unique())
    for name in bench.point_arc_lengths:
        if name not in names:
            known = ", ".join(map(repr, names))
            raise DataError(
                f"--at {name}=...",
                "there is no such point",
                f"The points are {known}.",
            )


def measure_hanging_points(tables: ImportedTables, bench: BenchHints) -> HangingString:
    """Measure arc lengths of points on the string at rest.

    Raises DataError if they were not seen at rest, or do not hang from the hand.
    """
    measured = measurements_of_tables(tables, bench)
    resting = find_resting_points(measured) if measured else None
    if resting is None:
        require_length(bench)
        raise DataError(
            "",
            "it is unknown how far along the string each point is: not all of "
            "them were seen at rest",
            "Film faster or begin earlier, or give the places in metres: --at "
            "tip=0.30.",
        )
    hanging = fit_hanging_string(resting, bench.length)
    if not hanging.is_rod:
        refuse_resting_points(resting, hanging)
    return hanging


def describe_hanging_points(
    hanging: HangingString, arc_lengths: Mapping[str, float], bench: BenchHints
) -> list[str]:
    """Describe the length and arc lengths that were measured on the string at rest."""
    trials = format_count(len(hanging.distances), "trial")
    misfit = f"{MM_PER_M * hanging.misfit_m:.1f} mm"
    agreement = f"it hangs at rest, in {trials} {misfit} from a heavy rod"
    notes = []
    if not bench.length:
        notes.append(describe_inferred_length(hanging.length, agreement))
    if len(arc_lengths) > 1:
        places = [f"{name or 'point'} {s:.3f} m" for name, s in arc_lengths.items()]
        notes.append(
            f"the points are placed along the string, the last at its end ({agreement})"
            f": {', '.join(places)}. Give their places with --at"
        )
    return notes


def require_length(bench: BenchHints) -> float:
    """Return the string's length [m]; raise DataError if it is not stated."""
    if bench.length is None:
        raise DataError(
            "",
            "the string's length is unknown",
            "Measure it from the grasp to the tip, and give it: --length 0.30.",
        )
    return bench.length


def refuse_resting_points(resting: RestingPoints, hanging: HangingString) -> None:
    """Refuse points without arc lengths that do not hang from the hand."""
    worst = int(np.nanmax(hanging.distances, axis=1).argmax())
    hand = resting.hands[worst, :2]
    places = [f"the hand rests at {format_place(hand)}"]
    for name, place in zip(resting.names, resting.places[worst], strict=True):
        places.append(f"{name or 'the point'} at {format_place(hand + place)}")
    raise DataError(
        "",
        "it is unknown how far along the string each point is: at rest they are "
        f"{MM_PER_M * hanging.misfit_m:.0f} mm from a heavy rod in this hand",
        f"They are farthest from it in trial {resting.trials[worst]}: "
        f"{', '.join(places)}. Look at --links, --base and --length, at the "
        "order, signs and zeros of the joints (--map q1=-elbow+90), at the unit "
        "and directions of x and y (--y-down), and whether the last point is "
        "the string's end. If all are right, give the places in metres: --at "
        "tip=0.30. A drawing then shows arm and string.",
    )


def format_place(xy: np.ndarray) -> str:
    """Format a position (2,) [m]."""
    return f"({xy[0]:.3f}, {xy[1]:.3f}) m"


def describe_inferred_length(length: float, source: str) -> str:
    """Describe the source of an inferred length [m]."""
    return (
        f"the string seems to be {length:.3f} m long ({source}). "
        "Measure it, and give it with --length"
    )


def select_columns(points: pd.DataFrame) -> pd.DataFrame:
    """Return the columns of our format."""
    names = ("trial", "t", "s", "x", "y", "sigma", "valid")
    selected = points[[name for name in names if name in points]]
    if "valid" in points:
        selected = selected.assign(valid=selected["valid"].fillna(True).astype(bool))
    return selected


def align_roughly(
    points: pd.DataFrame, grasp: pd.DataFrame, length: float
) -> dict[str, float]:
    """Return a rough offset to add to the times of points of each trial [s].

    It is the centre of the interval that is possible for any string. Raises DataError
    if nothing moves, the string was seen too rarely, or no trial has both hand and
    points.
    """
    hands = dict(list(grasp.groupby("trial")))
    trials = []
    for name, rows in points.groupby("trial"):
        if name in hands:
            observation = Observation(
                str(name),
                rows.dropna(),
                READINGS.empty(),
                MASKS.empty(),
                grasp=hands[name].drop(columns="trial").sort_values("t"),
            )
            trials.append(CheckedTrial(observation, None, length))
    if not trials:
        raise DataError(
            "--clock fit",
            "clocks are aligned by points of the string, and no trial has both "
            "these and the hand's motion",
            "Give the seconds to add: --clock=-0.35",
        )
    if all(trial.is_undersampled for trial in trials):
        raise DataError(
            "points",
            describe_sampling(trials[0]),
            f"{SAMPLING_REMEDY}.",
        )
    windows = possible_windows(trials)
    # a trial that shows no motion has the clocks of the others
    usual = float(np.median([window.middle for window in windows.values()]))
    added = dict.fromkeys((trial.name for trial in trials), usual)
    return added | {name: window.middle for name, window in windows.items()}


def write_dataset(
    imported: ImportedDataset, folder: Path, files: Sequence[Path], command: str
) -> None:
    """Write a dataset as a new folder.

    The hashes of the imported files are stored, and the command that makes the dataset
    again.
    """
    disk.make_folder(folder)
    hashes = {file.name: content_hash(file) for file in files}
    origin = {"step": "import", "files": hashes, "command": command}
    tables = [(imported.hand_table, imported.hand_rows)]
    if len(imported.points):
        tables.append((POINTS, imported.points))
    for table, rows in tables:
        write_table(with_trial(table), rows, folder / f"{table.name}.parquet", origin)
    for name, film in imported.films.items():
        disk.make_folder(folder / "videos")
        shutil.copyfile(film, folder / "videos" / f"{name}{film.suffix}")
    metadata = imported.metadata | {"imported": hashes}
    text = METADATA_HEADER + yaml.safe_dump(metadata, sort_keys=False)
    disk.write(folder / DATASET_FILE, mark_yaml_end(text).encode())
