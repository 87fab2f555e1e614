"""Datasets with deliberate mistakes of geometry, units, times and files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pandas as pd

from stringcast.stages.check.consistency.record import arm_poses
from stringcast.stages.model.engine.simulate import simulate
from stringcast.stages.model.hand import resample_hand_motion
from stringcast.stages.model.interpolation import interpolate_rows
from stringcast.stages.model.string import String
from tests.conftest import TRUTH

TWO_CLOCKS_LINKS, TWO_CLOCKS_BASE = (0.28, 0.22, 0.12), (0.1, 0.3)
STRIP = TRUTH | {
    "bending_stiffness": 25.0,
    "bending_damping": 0.02,
    "grasp_stiffness": 20.0,
    "grasp_damping": 0.02,
}
TableEdit: TypeAlias = Callable[[pd.DataFrame, int], pd.DataFrame]
UNIT_SIZES = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "in": 0.0254}


@dataclass(frozen=True)
class Bench:
    """Recorded trials, the stated geometry, and how both are written to files.

    Attributes
    ----------
    hands
        Times (K,) and joint angles (K, J) [rad] of each trial.
    points
        Times (F,) and positions (F, 2) [m] by name, of each trial.
    links, base, length
        Stated geometry [m]; None: not stated.
    angle_unit, length_unit
        Units of the files.
    angle_name, length_name
        Units in the column names; empty if none.
    options
        Further options of the command.
    fps
        Frame rate, if the tracker writes no times.
    clock
        Hand time minus point time [s].
    edits
        Changes of the tables "robot" and "tracker"; they get table and trial number.
    csv
        Options of `DataFrame.to_csv`.
    """

    hands: list[tuple[np.ndarray, np.ndarray]]
    points: list[dict[str, tuple[np.ndarray, np.ndarray]]]
    links: tuple[float, ...]
    base: tuple[float, float] | None
    length: float | None
    angle_unit: str = "deg"
    length_unit: str = "mm"
    angle_name: str = "deg"
    length_name: str = "mm"
    options: tuple[str, ...] = ()
    fps: float | None = None
    clock: float = 0.0
    edits: Mapping[str, TableEdit] = field(default_factory=dict)
    csv: Mapping[str, Any] = field(default_factory=dict)

    def write(self, folder: Path) -> list[str]:
        """Write the files; return the arguments of the command."""
        robots, trackers = [], []
        for number, (t, joints) in enumerate(self.hands, 1):
            unit = {"deg": 180 / np.pi, "rad": 1.0, "raw": 1.0}[self.angle_unit]
            ending = f"_{self.angle_name}" if self.angle_name else ""
            table = {"time_s": t}
            for joint in range(joints.shape[1]):
                table[f"joint{joint + 1}{ending}"] = joints[:, joint] * unit
            robots.append(self._write(folder, "robot", number, table))
        for number, points in enumerate(self.points, 1):
            first = next(iter(points.values()))[0]
            table = {} if self.fps else {"time_s": first}
            ending = f"_{self.length_name}" if self.length_name else ""
            for name, (_, xy) in points.items():
                for axis in range(2):
                    scaled = xy[:, axis] / UNIT_SIZES[self.length_unit]
                    table[f"{name}_{'xy'[axis]}{ending}"] = scaled
            trackers.append(self._write(folder, "tracker", number, table))
        words = [*robots, *(trackers if self.points else [])]
        if self.links:
            words.append("--links=" + ",".join(f"{link:.6g}" for link in self.links))
        if self.base is not None:
            words.append(f"--base={self.base[0]:.6g},{self.base[1]:.6g}")
        if self.length is not None:
            words.append(f"--length={self.length:.6g}")
        if self.fps:
            words.append(f"--fps={self.fps:g}")
        return [*words, *self.options]

    def _write(
        self, folder: Path, name: str, number: int, columns: dict[str, np.ndarray]
    ) -> str:
        table = pd.DataFrame(columns)
        if name in self.edits:
            table = self.edits[name](table, number)
        path = folder / f"{name}_{number}.csv"
        table.to_csv(path, index=False, **self.csv)
        return str(path)

    def with_joints(self, change: Callable[[np.ndarray], np.ndarray]) -> Bench:
        """Change the joint angles (K, J)."""
        return replace(self, hands=[(t, change(joints)) for t, joints in self.hands])

    def with_points(self, change: Callable[[np.ndarray], np.ndarray]) -> Bench:
        """Change the positions (F, 2)."""
        trials = []
        for points in self.points:
            trials.append({name: (t, change(xy)) for name, (t, xy) in points.items()})
        return replace(self, points=trials)

    def with_tip_alone(self) -> Bench:
        """Keep only the tip."""
        return replace(self, points=[{"tip": points["tip"]} for points in self.points])

    def with_rate(self, factor: float) -> Bench:
        """Omit the times of points; state the frame rate multiplied by a factor."""
        t = next(iter(self.points[0].values()))[0]
        rate = 1 / float(np.median(np.diff(t)))
        evened = []
        for points in self.points:
            new = {}
            for name, (times, xy) in points.items():
                even = np.arange(times[0], times[-1], 1 / rate)
                new[name] = (even, interpolate_rows(even, times, xy))
            evened.append(new)
        fps = round(rate) * factor
        if self.clock:
            return replace(self, points=evened, fps=fps)
        # counted frames begin at 0, even where both files share a clock
        options = (*self.options, f"--clock={t[0]:g}")
        return replace(self, points=evened, fps=fps, options=options)


def simulated_bench(material: Mapping[str, float] = STRIP) -> Bench:
    """Simulate three casts of a string, with clocks 81 s apart."""
    links, base, length = (0.28, 0.22, 0.12), (0.1, 0.3), 0.32
    rng = np.random.default_rng(5)
    string = String(length, points=21)
    values = np.array([[material[p.name] for p in string.parameters]])
    t = np.arange(0.0, 1.2, 0.004)
    hands, points = [], []
    for start, swing in (
        ((1.9, -0.9, -1.3), (-0.9, 0.5, 0.6)),
        ((2.1, -1.1, -1.2), (-1.0, 0.2, 0.9)),
        ((1.7, -0.7, -1.4), (-0.6, 0.8, 0.3)),
    ):
        share = np.clip((t - 0.15) / 0.6, 0, 1)
        progress = share**3 * (10 - 15 * share + 6 * share**2)
        joints = np.array(start) + progress[:, None] * np.array(swing)
        pose = arm_poses(joints, links, base)
        frames = np.arange(0.0, 1.19, 0.005)
        moved = simulate(string, resample_hand_motion(t, pose), values, frames)
        seen = {}
        for name, node in (("tip", 20), ("mid", 10)):
            noise = 6e-4 * rng.standard_normal((len(frames), 2))
            seen[name] = (frames, moved.points[0, :, node] + noise)
        hands.append((t + 81.0, joints))
        points.append(seen)
    return Bench(hands, points, links, base, length, clock=81.0)


def two_clocks_bench(folder: Path) -> Bench:
    """Read an independent simulation, and turn its y up."""
    hands, points = [], []
    for number in range(1, 5):
        robot = pd.read_csv(folder / f"robot_log_{number}.csv")
        tracker = pd.read_csv(folder / f"tracker_{number}.csv")
        joints = np.radians(robot.filter(like="joint").to_numpy())
        hands.append((robot["timestamp_ms"].to_numpy() / 1e3, joints))
        seen = {}
        for name in ("tip", "mid"):
            xy = tracker[[f"{name}_x_mm", f"{name}_y_mm"]].to_numpy() * [1e-3, -1e-3]
            seen[name] = (tracker["time_s"].to_numpy(), xy)
        points.append(seen)
    bench = Bench(hands, points, TWO_CLOCKS_LINKS, TWO_CLOCKS_BASE, 0.32)
    return replace(bench, clock=5135.881)


def sample_bench(folder: Path) -> Bench:
    """Read tip and middle of the sample dataset."""
    arm, points = (
        pd.read_parquet(folder / f"{name}.parquet") for name in ("arm", "points")
    )
    places = np.sort(points["s"].unique())
    length = float(places[-1])
    middle = places[np.abs(places - length / 2).argmin()]
    hands, seen = [], []
    for name, rows in arm.groupby("trial"):
        here = points[points["trial"] == name]
        tracks = {}
        for point, s in (("tip", length), ("mid", middle)):
            track = here[here["s"] == s].sort_values("t")
            tracks[point] = (track["t"].to_numpy(), track[["x", "y"]].to_numpy())
        common = np.intersect1d(tracks["tip"][0], tracks["mid"][0])
        for point, (t, xy) in tracks.items():
            tracks[point] = (common, xy[np.isin(t, common)])
        hands.append((rows["t"].to_numpy(), rows[["q1", "q2", "q3"]].to_numpy()))
        seen.append(tracks)
    return Bench(hands, seen, (0.25, 0.2, 0.135), (0.2, 0.2), length)


def encoder_counts(joints: np.ndarray) -> np.ndarray:
    """Return wrapping encoder counts, 4096 a turn, centred at 2048."""
    return np.floor(joints / (2 * np.pi) * 4096 + 2048) % 4096


def rotate(trials: list) -> list:
    """Give each trial the data of the next one."""
    return [*trials[1:], trials[0]]


def exchange_names(bench: Bench) -> Bench:
    """Exchange the names tip and mid, and state their arc lengths."""
    points = [{"tip": p["mid"], "mid": p["tip"]} for p in bench.points]
    places = (f"--at=tip={bench.length:.6g}", f"--at=mid={bench.length / 2:.6g}")
    return replace(bench, points=points, options=places)


def z_constant(bench: Bench) -> Bench:
    """Write a coordinate in which the string does not move as y."""
    return bench.with_points(lambda xy: np.stack([xy[:, 0], 0.02 + 0 * xy[:, 1]], -1))


def misorder(*order: int) -> Callable[[Bench], Bench]:
    """Permute the joints."""
    return lambda bench: bench.with_joints(lambda joints: joints[:, list(order)])


def convention(
    signs: tuple[int, ...], zeros: tuple[float, ...]
) -> Callable[[Bench], Bench]:
    """Write joints with other signs and zeros [degrees]."""
    return lambda bench: bench.with_joints(
        lambda joints: joints * np.array(signs) + np.radians(zeros)
    )


def matrix(*rows: tuple[float, float]) -> Callable[[Bench], Bench]:
    """Multiply positions by a matrix."""
    return lambda bench: bench.with_points(lambda xy: xy @ np.array(rows, float).T)


def in_unit(unit: str, name: str = "") -> Callable[[Bench], Bench]:
    """Write points in a unit, with another unit or none in their names."""
    return lambda bench: replace(bench, length_unit=unit, length_name=name)


def scaled(field_name: str, factor: float) -> Callable[[Bench], Bench]:
    """Scale stated lengths."""

    def change(bench: Bench) -> Bench:
        value = getattr(bench, field_name)
        if isinstance(value, tuple):
            return replace(bench, **{field_name: tuple(factor * one for one in value)})
        return replace(bench, **{field_name: factor * value})

    return change


def shifted(x: float, y: float) -> Callable[[Bench], Bench]:
    """Shift the stated base [m]."""

    def change(bench: Bench) -> Bench:
        assert bench.base is not None
        return replace(bench, base=(bench.base[0] + x, bench.base[1] + y))

    return change


def edited(name: str, edit: TableEdit) -> Callable[[Bench], Bench]:
    """Edit the tables "robot" or "tracker"."""
    return lambda bench: replace(bench, edits={name: edit})


def without(name: str, *columns: str) -> Callable[[Bench], Bench]:
    """Drop columns."""
    return edited(name, lambda table, _: table.drop(columns=[*columns]))


def written(**csv: Any) -> Callable[[Bench], Bench]:
    """Write tables with options of `DataFrame.to_csv`."""
    return lambda bench: replace(bench, csv=csv)


def first_alone(change: Callable[[pd.DataFrame], pd.DataFrame]) -> TableEdit:
    """Change the table of the first trial only."""
    return lambda table, number: change(table) if number == 1 else table


def with_times(change: Callable[[np.ndarray], np.ndarray], name: str = "") -> TableEdit:
    """Change time stamps (K,) [s], and the name of their column."""

    def edit(table: pd.DataFrame, _: int) -> pd.DataFrame:
        table = table.assign(time_s=change(table["time_s"].to_numpy()))
        return table.rename(columns={"time_s": name or "time_s"})

    return edit


def with_both_times(
    change: Callable[[np.ndarray], np.ndarray], name: str = ""
) -> Callable[[Bench], Bench]:
    """Change the time stamps of both files."""
    edit = with_times(change, name)
    return lambda bench: replace(bench, edits={"robot": edit, "tracker": edit})


def repeat_stamps(t: np.ndarray) -> np.ndarray:
    """Give every tenth row the stamp of the row before."""
    t = t.copy()
    t[10::10] = t[9:-1:10]
    return t


def turn_back(t: np.ndarray) -> np.ndarray:
    """Restart the clock in the middle."""
    return np.where(np.arange(len(t)) < len(t) // 2, t, t - (t[len(t) // 2] - t[0]))


def keep_some(table: pd.DataFrame, _: int) -> pd.DataFrame:
    """Keep a random 60 % of the rows."""
    rng = np.random.default_rng(11)
    return table[rng.random(len(table)) < 0.6]


def lose(share: float) -> TableEdit:
    """Remove the points from a share of frames."""

    def edit(table: pd.DataFrame, number: int) -> pd.DataFrame:
        rng = np.random.default_rng(number)
        positions = [name for name in table if name != "time_s"]
        table = table.copy()
        table.loc[rng.random(len(table)) < share, positions] = np.nan
        return table

    return edit


def throw_out(table: pd.DataFrame, number: int) -> pd.DataFrame:
    """Displace the points in one of twenty frames."""
    rng = np.random.default_rng(number)
    is_out = rng.random(len(table)) < 0.05
    names = [name for name in table if name != "time_s"]
    farther = table[names] + 3 * (table[names].max() - table[names].min())
    table = table.copy()
    table.loc[is_out, names] = farther[is_out]
    return table


def hide_half(table: pd.DataFrame, number: int) -> pd.DataFrame:
    """Remove the tip from the second half of each trial."""
    table = table.copy()
    names = [name for name in table if str(name).startswith("tip")]
    table.loc[len(table) // 2 :, names] = np.nan
    return table


def put_text(table: pd.DataFrame, number: int) -> pd.DataFrame:
    """Write a word into every fifteenth row."""
    table = table.astype(object)
    table.iloc[::15, 1:] = "lost"
    return table


def film_slowly(bench: Bench) -> Bench:
    """Film with 5 frames a second."""
    step = round(0.2 / float(np.median(np.diff(bench.points[0]["tip"][0]))))
    return edited("tracker", lambda table, _: table[::step])(bench)


def rename_joints(*names: str) -> Callable[[Bench], Bench]:
    """Rename the joints."""

    def edit(table: pd.DataFrame, _: int) -> pd.DataFrame:
        return table.set_axis(["time_s", *names], axis=1)

    return edited("robot", edit)


def wrap_joint(table: pd.DataFrame, _: int) -> pd.DataFrame:
    """Wrap an angle [deg] in the middle of its range."""
    name = table.columns[2]
    angle = table[name].to_numpy()
    cut = (angle.min() + angle.max()) / 2
    return table.assign(**{name: (angle - cut) % 360 + cut})


def count_joint(table: pd.DataFrame, _: int) -> pd.DataFrame:
    """Write the second joint in encoder counts, the others in degrees."""
    name = table.columns[2]
    counts = encoder_counts(np.radians(table[name].to_numpy()))
    return table.assign(**{name: counts})


# mistake -> (change of the bench, pattern in the output)
MISTAKES: dict[str, tuple[Callable[[Bench], Bench], str]] = {
    "clean": (lambda bench: bench, "Usable"),
    "joints 1 and 2 swapped": (misorder(1, 0, 2), "--map q1=joint2_deg"),
    "joints 2 and 3 swapped": (misorder(0, 2, 1), "--map q2=joint3_deg"),
    "joints 1 and 3 swapped": (misorder(2, 1, 0), "--map q1=joint3_deg"),
    "joint 2 clockwise": (
        convention((1, -1, 1), (0, 0, 0)),
        "--map q2=-joint2_deg --map q3=joint3_deg",
    ),
    "joint 1 from above": (
        convention((1, 1, 1), (-90, 0, 0)),
        r"--map q1=joint1_deg\+90 --map q2=joint2_deg",
    ),
    "joints clockwise from above": (
        convention((-1, -1, -1), (90, 0, 0)),
        r"--map q1=-joint1_deg\+90 --map q2=-joint2_deg",
    ),
    "missing y of the tip": (
        without("tracker", "tip_y_mm"),
        "column 'tip_x_mm' is the only coordinate",
    ),
    "missing joint": (
        without("robot", "joint2_deg"),
        "angles of 2 joints",
    ),
    "radians named degrees": (
        lambda bench: bench.with_joints(np.radians),
        "--rad",
    ),
    "degrees named rad": (lambda bench: replace(bench, angle_name="rad"), "--deg"),
    "no units in names": (
        lambda bench: replace(bench, angle_name="", length_name=""),
        "--unit",
    ),
    "x and y exchanged": (matrix((0, 1), (1, 0)), "--plane=y,x"),
    "y down": (matrix((1, 0), (0, -1)), "--y-down"),
    "x to the left": (matrix((-1, 0), (0, 1)), "--plane=-x,y"),
    "another plane": (z_constant, "never changes"),
    "points in mm": (in_unit("mm"), "=mm"),
    "points in cm": (in_unit("cm"), "=cm"),
    "points in inch": (in_unit("in"), "=in"),
    "cm named mm": (in_unit("cm", "mm"), "=cm"),
    "inch named mm": (in_unit("in", "mm"), "=in"),
    "links in inch": (scaled("links", 1 / 0.0254), "--links="),
    "links in mm": (scaled("links", 1000.0), "would be metres|--links="),
    "links in cm": (scaled("links", 100.0), "would be metres|--links="),
    "length in mm": (scaled("length", 1000.0), "would be metres|--length="),
    "length in cm": (scaled("length", 100.0), "would be metres|--length="),
    "length in inch": (scaled("length", 1 / 0.0254), "would be metres|--length="),
    "length 20 % too long": (scaled("length", 1.2), "fits a length of about"),
    "no length": (lambda bench: replace(bench, length=None), "Measure it"),
    "no base": (lambda bench: replace(bench, base=None), "--base="),
    "base off in x": (shifted(0.3, 0.0), "--base="),
    "base off in y": (shifted(0.0, 0.3), "--base="),
    "base off by 6 cm": (shifted(-0.06, 0.0), "--base="),
    "fps half": (lambda bench: bench.with_rate(0.5), "--fps=?.?200"),
    "fps 25 % too high": (lambda bench: bench.with_rate(1.25), "--fps=?.?200"),
    "fps double": (lambda bench: bench.with_rate(2.0), "--fps=?.?200"),
    "tip and mid exchanged": (exchange_names, "--at"),
    "trackers shuffled": (
        lambda bench: replace(bench, points=rotate(bench.points)),
        "changed trials",
    ),
    "absolute joint angles": (
        lambda bench: bench.with_joints(lambda joints: np.cumsum(joints, axis=1)),
        "--absolute",
    ),
    "encoder counts": (
        lambda bench: replace(
            bench.with_joints(encoder_counts), angle_unit="raw", angle_name=""
        ),
        "--counts",
    ),
    "one trial": (
        lambda bench: replace(bench, hands=bench.hands[:1], points=bench.points[:1]),
        "one trial can be used",
    ),
    "no tracker": (lambda bench: replace(bench, points=[]), "where the string was"),
    "mm and y down": (
        lambda bench: in_unit("mm")(matrix((1, 0), (0, -1))(bench)),
        "--y-down",
    ),
    "mm, y down and absolute joint angles": (
        lambda bench: in_unit("mm")(
            matrix((1, 0), (0, -1))(
                bench.with_joints(lambda joints: np.cumsum(joints, axis=1))
            )
        ),
        "--absolute",
    ),
}
FILE_MISTAKES: dict[str, tuple[Callable[[Bench], Bench], str]] = {
    "tracker's stamps doubled": (
        edited("tracker", with_times(repeat_stamps)),
        "another value at the same trial, t",
    ),
    "robot's stamps doubled": (
        edited("robot", with_times(repeat_stamps)),
        "another value at the same trial, t",
    ),
    "tracker's stamps turn back": (
        edited("tracker", with_times(turn_back)),
        "two recordings seem to be in one",
    ),
    "robot's stamps turn back": (
        edited("robot", with_times(turn_back)),
        "two recordings seem to be in one",
    ),
    "rows in reverse": (
        edited("tracker", lambda table, _: table[::-1]),
        "They are put in order",
    ),
    "uneven frames": (edited("tracker", keep_some), "Usable"),
    "epoch seconds": (with_both_times(lambda t: t + 1.7e9), "times begin at"),
    "epoch seconds of the robot": (
        edited("robot", with_times(lambda t: t + 1.7e9)),
        "--clock fit",
    ),
    "epoch ns": (with_both_times(lambda t: (t + 1.7e9) * 1e9, "stamp_ns"), "Usable"),
    "epoch ns named s": (
        with_both_times(lambda t: (t + 1.7e9) * 1e9),
        "call the column t_ns",
    ),
    "epoch float32": (
        with_both_times(lambda t: (t + 1.7e9).astype(np.float32).astype(float)),
        "stored as float32",
    ),
    "ms named s": (with_both_times(lambda t: t * 1e3), "call the column t_ms"),
    "10 % NaN": (edited("tracker", lose(0.1)), "x is not a finite number"),
    "90 % NaN": (
        edited("tracker", lose(0.9)),
        "too few are left to show anything|were seen before the hand moved",
    ),
    "10 % NaN of the robot": (edited("robot", lose(0.1)), "not a finite number"),
    "outliers": (edited("tracker", throw_out), "jump away and back"),
    "tip hidden half of the time": (
        edited("tracker", hide_half),
        "x is not a finite number",
    ),
    "text in cells": (edited("tracker", put_text), "not a (finite )?number"),
    "5 fps": (film_slowly, "Film faster"),
    "one frame": (edited("tracker", lambda table, _: table[:1]), "in 1 frame"),
    "one frame in one trial": (
        edited("tracker", first_alone(lambda table: table[:1])),
        "is left out: the string was seen in 1 frame",
    ),
    "empty file": (
        edited("tracker", first_alone(lambda _: pd.DataFrame())),
        "tracker_1.csv: it is empty",
    ),
    "heading alone": (
        edited("tracker", first_alone(lambda table: table[:0])),
        "has no rows",
    ),
    "joints called A1": (rename_joints("A1_deg", "A2_deg", "A3_deg"), "Usable"),
    "joints called alpha": (rename_joints("alpha", "beta", "gamma"), "--map"),
    "angle wraps at 180 degrees": (edited("robot", wrap_joint), "Usable"),
    "one joint in counts": (edited("robot", count_joint), "counts of an encoder"),
    "decimal comma": (written(sep=";", decimal=","), "Usable"),
    "BOM and CRLF": (
        written(encoding="utf-8-sig", lineterminator="\r\n"),
        "Usable",
    ),
    "slow motion on both clocks": (
        with_both_times(lambda t: 4 * t),
        "Multiply t of both by 0.25",
    ),
    "clock 100 ppm fast": (
        edited("tracker", with_times(lambda t: t * 1.0001)),
        "Usable",
    ),
}
NEEDS_TWO_POINTS = {"tip and mid exchanged"}
