"""From what files of others hold to a folder in our own format: arc lengths, clocks and
dataset.yaml are added.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from stringcast.data import disk
from stringcast.data.artifacts import ARM, GRASP, MASKS, POINTS, READINGS, Observation
from stringcast.data.dataset import MIN_OVERLAP_S, with_trial
from stringcast.data.images import Video
from stringcast.data.importers.gather import ImportedTables
from stringcast.data.metadata import DATASET_FILE, FORMAT_VERSION
from stringcast.data.schema import DataError, Table
from stringcast.data.store import content_hash, write_table
from stringcast.stages.check.at_rest import (
    attach_arc_lengths,
    estimate_arc_lengths,
    grasp_poses,
)
from stringcast.stages.check.measured import CheckedTrial
from stringcast.stages.check.time_shifts import estimate_time_shifts
from stringcast.stages.model.arm import Arm

# of an arm whose angles our format holds; the pose of the hand stands for any other
FORMAT_JOINTS = 3
# of the length: one string hangs nearer to the same in all trials, bent by the way it
# is held
MAX_LENGTH_SPREAD = 0.1
EXAMPLE_LINKS_M = ("0.25", "0.20", "0.135")  # [m] of an example
# unused: poses of the hand are given
UNUSED_ARM = Arm((1.0,), (0.0, 0.0), (-1.0,), (1.0,), (1.0,), (1.0,), 1.0, 0.005)
METADATA_HEADER = """\
# Written by `import`. All is in metres, seconds, radians and kilograms; what each name means: data/README.md.
"""


@dataclass(frozen=True)
class BenchHints:
    """The user's description of the bench.

    length: of the string [m]. links, base: of the arm [m]. at: how far along the string
    each point is [m], by its name. fit_clock: lay the clocks over one another by the
    motion. moving: the string swings already when trials begin. turn: added to the
    hand's direction [rad]. fps, px_per_m, origin_px: of films.
    """

    length: float | None = None
    links: tuple[float, ...] = ()
    base: tuple[float, float] = (0.0, 0.0)
    point_arc_lengths: Mapping[str, float] = field(default_factory=dict)
    fit_clock: bool = False
    starts_moving: bool = False
    hand_turn: float = 0.0
    fps: float | None = None
    px_per_m: float | None = None
    origin_px: tuple[float, float] | None = None


@dataclass(frozen=True)
class ImportedDataset:
    """A dataset that is not written yet. hand: the table of the hand's motion, ARM or
    GRASP, and its rows. points: rows of POINTS. films: video files by trial. metadata:
    dataset.yaml. notes: what was worked out, for people.
    """

    hand_table: Table
    hand_rows: pd.DataFrame
    points: pd.DataFrame
    films: Mapping[str, Path]
    metadata: dict[str, Any]
    notes: Sequence[str]

    @property
    def trials_without_common_time(self) -> list[str]:
        """Trials of which arm and camera have next to nothing in common by their
        clocks.
        """
        both = [
            {name: rows["t"] for name, rows in table.groupby("trial")}
            for table in (self.hand_rows, self.points)
        ]
        return [
            name
            for name in sorted(both[0].keys() & both[1].keys())
            if min(t[name].max() for t in both) - max(t[name].min() for t in both)
            < MIN_OVERLAP_S
        ]


def convert_recordings(what: ImportedTables, bench: BenchHints) -> ImportedDataset:
    """The dataset that recordings make. Raises DataError naming the option where
    something must be said.
    """
    notes: list[str] = []
    grasp = imported_grasp_poses(what, bench)
    as_joints = len(what.joints) == FORMAT_JOINTS
    motion = what.motion[["trial", "t", *what.joints]] if as_joints else grasp
    points, length = locate_points(what, grasp, bench, notes)
    if bench.fit_clock:
        points = align_clocks(points, grasp, length, notes)
    about: dict[str, Any] = {"format": FORMAT_VERSION, "string": {"length": length}}
    about |= (
        {"arm": {"links": list(bench.links), "base": list(bench.base)}}
        if as_joints
        else {}
    )
    if what.films:
        fps = bench.fps or what.fps
        said = {
            "fps": fps,
            "px_per_m": bench.px_per_m,
            "origin_px": bench.origin_px and list(bench.origin_px),
        }
        options = {
            "fps": "--fps 240",
            "px_per_m": "--px-per-m 340",
            "origin_px": "--origin-px 251.5,387.5",
        }
        if missing := [options[name] for name, value in said.items() if not value]:
            raise DataError(
                f"of a film it must be known where it was taken from. Say {' '.join(missing)}, as it was."
            )
        height, width = Video(next(iter(what.films.values())))[0].shape
        about["camera"] = {**said, "width": width, "height": height}
    about |= {"initial": "moving"} if bench.starts_moving else {}
    return ImportedDataset(
        ARM if as_joints else GRASP, motion, points, what.films, about, notes
    )


def imported_grasp_poses(what: ImportedTables, bench: BenchHints) -> pd.DataFrame:
    """Poses of the grasp, as measured or by the arm's links."""
    named = what.motion[["trial", "t"]]
    if not what.joints:
        return named.assign(
            **{axis: what.motion[axis] for axis in "xy"},
            theta=what.motion["theta"] + bench.hand_turn,
        )
    count = len(what.joints)
    if len(bench.links) != count:
        there = (
            f"{len(bench.links)} links are named"
            if bench.links
            else "no lengths of links"
        )
        raise DataError(
            f"there are the angles of {count} joint{'s' * (count > 1)}, and {there}. Say how long the links are, base "
            f"first: --links {','.join((EXAMPLE_LINKS_M * count)[:count])} --base 0,0. Where some do not turn in the plane, name "
            "those that do: --map q1=<column> --map q2=<column>."
        )
    return pd.concat(
        [named, grasp_poses(what.motion, np.array(bench.links), np.array(bench.base))],
        axis=1,
    )


def locate_points(
    what: ImportedTables, grasp: pd.DataFrame, bench: BenchHints, notes: list[str]
) -> tuple[pd.DataFrame, float]:
    """Points with arc lengths, and the string's length [m]: as said, or as it hangs at
    rest.
    """
    points = what.points
    if points.empty:
        return POINTS.empty().assign(trial=""), require_length(bench)
    names = list(points["point"].unique())
    for name in bench.point_arc_lengths:
        if name not in names:
            raise DataError(
                f"--at {name}=...: there is no such point. There are {', '.join(map(repr, names))}."
            )
    if "s" in points:
        return select_columns(points), bench.length or note_length(
            float(points["s"].max()), "the largest s", notes
        )
    hanging = {} if bench.starts_moving else estimate_arc_lengths(points, grasp)
    middle = {name: float(np.median(values)) for name, values in hanging.items()}
    at = dict(bench.point_arc_lengths) or (
        {names[0]: bench.length} if len(names) == 1 and bench.length else middle
    )
    if not at:
        require_length(bench)
        raise DataError(
            "it is not said how far along the string points are. Say it, in metres: --at tip=0.30."
        )
    length = bench.length or (
        max(bench.point_arc_lengths.values())
        if bench.point_arc_lengths
        else note_length(max(at.values()), describe_hanging_length(hanging), notes)
    )
    if not bench.point_arc_lengths and len(at) > 1:
        at = {name: s * length / max(at.values()) for name, s in at.items()}
        places = ", ".join(f"{name or 'point'} {s:.3f} m" for name, s in at.items())
        notes.append(
            f"points are taken to lie along the string as it hangs at rest: {places}. Say it with --at"
        )
    return select_columns(attach_arc_lengths(points, at)), length


def require_length(bench: BenchHints) -> float:
    if bench.length is None:
        raise DataError(
            "the string's length is not said. Measure it from the grasp to the tip: --length 0.30."
        )
    return bench.length


def describe_hanging_length(by_trial: Mapping[str, np.ndarray]) -> str:
    """Where a length of a string at rest is from, and how far trials agree. by_trial:
    arc lengths of points [m].
    """
    values = max(by_trial.values(), key=np.median)
    said = "it hangs at rest"
    if len(values) < 2:
        return said
    said += f": {values.min():.3f} to {values.max():.3f} m in {len(values)} trials"
    far = np.ptp(values) > MAX_LENGTH_SPREAD * np.median(values)
    return (
        said
        + ", which is too far apart for one string: are --links and --base right?"
        * bool(far)
    )


def note_length(length: float, why: str, notes: list[str]) -> float:
    notes.append(
        f"the string is taken to be {length:.3f} m long ({why}). Measure it, and say --length"
    )
    return round(length, 4)


def select_columns(points: pd.DataFrame) -> pd.DataFrame:
    """The columns of our format."""
    optional = [name for name in ("sigma", "valid") if name in points]
    whole = points[["trial", "t", "s", "x", "y", *optional]]
    return (
        whole.assign(valid=whole["valid"].fillna(True).astype(bool))
        if "valid" in optional
        else whole
    )


def align_clocks(
    points: pd.DataFrame, grasp: pd.DataFrame, length: float, notes: list[str]
) -> pd.DataFrame:
    """Points with times by the arm's clock, as far as the motion tells it."""
    hands = {
        str(name): rows.drop(columns="trial").sort_values("t")
        for name, rows in grasp.groupby("trial")
    }
    empty = READINGS.empty(), MASKS.empty()
    trials = [
        CheckedTrial(
            Observation(str(name), part.dropna(), *empty, grasp=hands[str(name)]),
            UNUSED_ARM,
            length,
        )
        for name, part in points.groupby("trial")
        if str(name) in hands
    ]
    later = estimate_time_shifts(trials)
    still = [seen.name for seen in trials if seen.name not in later]
    if still:
        raise DataError(
            f"trial {still[0]}: hand or string never begins to move. Say what to add: --clock=-0.35"
        )
    same = len({*later.values()}) == 1
    for name, shift in list(later.items())[: 1 if same else None]:
        who = "in all trials" if same else f"in trial {name}"
        notes.append(
            f"{shift:+.3f} s are added to the camera's clock {who}, by the motion of hand and string"
        )
    slack = "" if same else ", to 25 ms in a trial whose string hangs slack at first"
    notes.append(
        f"clocks laid over one another so are good to about a frame{slack}; a diagnosis names the rest time_offset"
    )
    return points.assign(t=points["t"] + points["trial"].map(later).fillna(0.0))


def write_dataset(
    what: ImportedDataset, folder: Path, files: Sequence[Path], command: str
) -> None:
    """Write a dataset as a folder that is not there yet. command: that makes it again."""
    disk.make_folder(folder)
    origin = {
        "step": "import",
        "files": {file.name: content_hash(file) for file in files},
        "command": command,
    }
    write_table(
        with_trial(what.hand_table),
        what.hand_rows,
        folder / f"{what.hand_table.name}.parquet",
        origin,
    )
    if len(what.points):
        write_table(
            with_trial(POINTS), what.points, folder / f"{POINTS.name}.parquet", origin
        )
    for name, film in what.films.items():
        disk.make_folder(folder / "videos")
        shutil.copyfile(film, folder / "videos" / f"{name}{film.suffix}")
    about = {**what.metadata, "imported": origin["files"]}
    disk.write(
        folder / DATASET_FILE,
        (METADATA_HEADER + yaml.safe_dump(about, sort_keys=False)).encode(),
    )
