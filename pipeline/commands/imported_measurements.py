"""Measurements of imported files on the bench described by the user."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from stringcast.data.artifacts import valid_rows
from stringcast.data.importers.gather import ImportedTables
from stringcast.data.schema import DataError
from stringcast.stages.check.consistency.dataset import tracks_along_string
from stringcast.stages.check.consistency.record import (
    Measurements,
    Recording,
    Track,
    arm_poses,
)
from stringcast.stages.check.measured import drop_spikes
from stringcast.stages.report.formatting import format_count

MIN_ROWS = 5  # of a table; fewer are not judged
EXAMPLE_LINKS_M = ("0.25", "0.20", "0.135")


@dataclass(frozen=True)
class BenchHints:
    """The user's description of the bench.

    Attributes
    ----------
    length
        Length of the string [m].
    links, base
        Lengths of the arm's links and position of joint 1 [m].
    point_arc_lengths
        Arc length of each point by its name [m].
    fit_clock
        Whether the clocks of arm and camera are aligned by the motion.
    clock_error
        Error of the stated clock offset [s]; None if unknown.
    geometry_is_measured
        Whether the geometry was measured, so that implausible motion is accepted.
    starts_moving
        Whether the string moves when trials begin.
    hand_turn
        Angle added to the hand's direction [rad].
    """

    length: float | None = None
    links: tuple[float, ...] = ()
    base: tuple[float, float] = (0.0, 0.0)
    point_arc_lengths: Mapping[str, float] = field(default_factory=dict)
    fit_clock: bool = False
    clock_error: float | None = None
    geometry_is_measured: bool = False
    starts_moving: bool = False
    hand_turn: float = 0.0


def measurements_of_tables(
    tables: ImportedTables, bench: BenchHints
) -> Measurements | None:
    """Convert tables to measurements; None if they cannot be judged."""
    grasp = imported_grasp_poses(tables, bench)  # refuses missing links
    if tables.points.empty:
        return None
    points = valid_rows(tables.points)
    points = points[np.isfinite(points[["t", "x", "y"]]).all(axis=1)]
    motion = tables.motion if tables.joints else grasp
    columns = tables.joints or ["x", "y", "theta"]
    motion = motion[np.isfinite(motion[["t", *columns]]).all(axis=1)]
    recordings = []
    for name, rows in motion.groupby("trial"):
        log = rows.drop_duplicates("t").sort_values("t")
        tracks = tracks_of(points[points["trial"] == name], bench)
        if len(log) < MIN_ROWS or not tracks:
            continue
        values = log[columns].to_numpy(float)
        joints, hand = (values, None) if tables.joints else (None, values)
        t = log["t"].to_numpy()
        moving = bench.starts_moving
        recordings.append(Recording(str(name), t, joints, hand, tracks, moving))
    if not recordings:
        return None
    return Measurements(
        tuple(recordings),
        bench.links,
        bench.base,
        bench.length,
        base_is_measured=bench.geometry_is_measured,
    )


def tracks_of(points: pd.DataFrame, bench: BenchHints) -> tuple[Track, ...]:
    """Return the tracks of a trial's points; only a few if arc lengths are known."""
    if "s" in points:
        known = points.dropna(subset=["s"])
        return tracks_along_string(known.sort_values(["t", "s"], kind="stable"))
    tracks = []
    for name in points["point"].unique():
        rows = points[points["point"] == name].drop_duplicates("t").sort_values("t")
        if len(rows) >= MIN_ROWS:
            s = bench.point_arc_lengths.get(name)
            t, xy = rows["t"].to_numpy(), rows[["x", "y"]].to_numpy(float)
            tracks.append(Track(str(name), s, *drop_spikes(t, xy)))
    return tuple(tracks)


def imported_grasp_poses(tables: ImportedTables, bench: BenchHints) -> pd.DataFrame:
    """Return poses of the grasp, measured or computed from joint angles and links."""
    motion = tables.motion
    times = motion[["trial", "t"]]
    if not tables.joints:
        theta = motion["theta"] + bench.hand_turn
        return times.assign(x=motion["x"], y=motion["y"], theta=theta)
    count = len(tables.joints)
    if len(bench.links) != count:
        example = ",".join((EXAMPLE_LINKS_M * count)[:count])
        files = {c.file.name for c in tables.used_columns if c.role in tables.joints}
        stated = f"--links gives {format_count(len(bench.links), 'length')}"
        if not bench.links:
            stated = "no --links are given"
        raise DataError(
            ", ".join(sorted(files)),
            f"the log holds the angles of {format_count(count, 'joint')}, and {stated}",
            f"Give one length for each joint, base first: --links {example} "
            "--base 0,0. If some joints do not turn in the plane, name those "
            "that do: --map q1=<column> --map q2=<column>.",
        )
    x, y, theta = arm_poses(motion[tables.joints].to_numpy(), bench.links, bench.base).T
    return times.assign(x=x, y=y, theta=theta)
