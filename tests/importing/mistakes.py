"""Common mistakes of geometry, made in the files of a bench on purpose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd

from stringcast.stages.check.consistency.record import arm_poses
from stringcast.stages.model.engine.simulate import simulate
from stringcast.stages.model.hand import resample_hand_motion
from stringcast.stages.model.string import String

TWO_CLOCKS_LINKS, TWO_CLOCKS_BASE = (0.28, 0.22, 0.12), (0.1, 0.3)
STRIP = {
    "axial_stiffness": 6e5,
    "axial_damping": 30.0,
    "bending_stiffness": 25.0,
    "bending_damping": 0.02,
    "linear_drag": 0.3,
    "quadratic_drag": 0.2,
    "grasp_stiffness": 20.0,
    "grasp_damping": 0.02,
}
UNIT_SIZES = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "in": 0.0254}


@dataclass(frozen=True)
class Bench:
    """Files of a bench as a user has them, with what the user states.

    Attributes
    ----------
    hands
        Times (K,) and joint angles (K, J) [rad] of each trial.
    points
        Times (F,) and positions (F, 2) [m] by name, of each trial.
    links, base, length
        What is stated [m]; None: not stated.
    angle_unit, length_unit
        In which the files are.
    angle_name, length_name
        What names of columns state; empty if nothing.
    options
        Further options.
    fps
        Frame rate, if the tracker writes no times.
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
    dropped: tuple[str, ...] = ()
    columns: dict[str, str] = field(default_factory=dict)

    def write(self, folder: Path) -> list[str]:
        """Write the files; return the words of the command."""
        robots, trackers = [], []
        for number, (t, joints) in enumerate(self.hands, 1):
            unit = {"deg": 180 / np.pi, "rad": 1.0, "raw": 1.0}[self.angle_unit]
            ending = f"_{self.angle_name}" if self.angle_name else ""
            table = {"time_s": t}
            for joint in range(joints.shape[1]):
                table[f"joint{joint + 1}{ending}"] = joints[:, joint] * unit
            robots.append(self._write(folder / f"robot_{number}.csv", table))
        for number, points in enumerate(self.points, 1):
            first = next(iter(points.values()))[0]
            table = {} if self.fps else {"time_s": first}
            ending = f"_{self.length_name}" if self.length_name else ""
            for name, (_, xy) in points.items():
                for axis in range(2):
                    scaled = xy[:, axis] / UNIT_SIZES[self.length_unit]
                    table[f"{name}_{'xy'[axis]}{ending}"] = scaled
            trackers.append(self._write(folder / f"tracker_{number}.csv", table))
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

    def _write(self, path: Path, table: dict[str, np.ndarray]) -> str:
        kept = {
            name: column for name, column in table.items() if name not in self.dropped
        }
        pd.DataFrame(kept).to_csv(path, index=False)
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
        """Return the bench with the tip as its only point."""
        return replace(self, points=[{"tip": points["tip"]} for points in self.points])

    def with_rate(self, stated: float) -> Bench:
        """Write no times of the points, and state a frame rate of 200 times a factor."""
        t = next(iter(self.points[0].values()))[0]
        rate = 1 / float(np.median(np.diff(t)))
        evened = []
        for points in self.points:
            new = {}
            for name, (times, xy) in points.items():
                even = np.arange(times[0], times[-1], 1 / rate)
                columns = [np.interp(even, times, column) for column in xy.T]
                new[name] = (even, np.stack(columns, axis=-1))
            evened.append(new)
        return replace(self, points=evened, fps=round(rate) * stated)


def simulated_bench() -> Bench:
    """Simulate three casts of a stiff string, with clocks 81 s apart."""
    links, base, length = (0.28, 0.22, 0.12), (0.1, 0.3), 0.32
    rng = np.random.default_rng(5)
    string = String(length, points=21)
    values = np.array([[STRIP[p.name] for p in string.parameters]])
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
    return Bench(hands, points, links, base, length)


def two_clocks_bench(folder: Path) -> Bench:
    """Return the bench of a simulation that is not ours, with y up."""
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
    return Bench(hands, points, TWO_CLOCKS_LINKS, TWO_CLOCKS_BASE, 0.32)


def sample_bench(folder: Path) -> Bench:
    """Return the bench of the sample, with its tip and middle."""
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
    """Return counts of 4096 a turn that wrap, from the middle."""
    return np.floor(joints / (2 * np.pi) * 4096 + 2048) % 4096


def rotate(trials: list) -> list:
    """Give each trial the data of the next one."""
    return [*trials[1:], trials[0]]


def exchange_names(bench: Bench) -> Bench:
    """Call the tip mid and the middle tip, and state their places."""
    points = [{"tip": p["mid"], "mid": p["tip"]} for p in bench.points]
    places = (f"--at=tip={bench.length:.6g}", f"--at=mid={bench.length / 2:.6g}")
    return replace(bench, points=points, options=places)


def z_constant(bench: Bench) -> Bench:
    """Take a plane in which the string does not move."""
    return bench.with_points(lambda xy: np.stack([xy[:, 0], 0.02 + 0 * xy[:, 1]], -1))


def misorder(*order: int) -> Callable[[Bench], Bench]:
    """Return the mistake of joints in another order."""
    return lambda bench: bench.with_joints(lambda joints: joints[:, list(order)])


def matrix(*rows: tuple[float, float]) -> Callable[[Bench], Bench]:
    """Return the mistake of positions multiplied by a matrix."""
    return lambda bench: bench.with_points(lambda xy: xy @ np.array(rows, float).T)


def in_unit(unit: str, name: str = "") -> Callable[[Bench], Bench]:
    """Return the mistake of points in a unit, with another or none in their names."""
    return lambda bench: replace(bench, length_unit=unit, length_name=name)


def scaled(field_name: str, factor: float) -> Callable[[Bench], Bench]:
    """Return the mistake of a stated length, or of several, in another unit."""

    def change(bench: Bench) -> Bench:
        value = getattr(bench, field_name)
        if isinstance(value, tuple):
            return replace(bench, **{field_name: tuple(factor * one for one in value)})
        return replace(bench, **{field_name: factor * value})

    return change


def shifted(x: float, y: float) -> Callable[[Bench], Bench]:
    """Return the mistake of an arm's base that is off [m]."""

    def change(bench: Bench) -> Bench:
        assert bench.base is not None
        return replace(bench, base=(bench.base[0] + x, bench.base[1] + y))

    return change


# mistake -> (how it is made, what the answer holds); an answer is the words of an
# option that is taken, or of a message
MISTAKES: dict[str, tuple[Callable[[Bench], Bench], str]] = {
    "clean": (lambda bench: bench, "Usable"),
    "joints 1 and 2 swapped": (misorder(1, 0, 2), "--map q1=joint2_deg"),
    "joints 2 and 3 swapped": (misorder(0, 2, 1), "--map q2=joint3_deg"),
    "joints 1 and 3 swapped": (misorder(2, 1, 0), "--map q1=joint3_deg"),
    "missing y of the tip": (
        lambda bench: replace(bench, dropped=("tip_y_mm",)),
        "column 'tip_x_mm' is the only coordinate",
    ),
    "missing joint": (
        lambda bench: replace(bench, dropped=("joint2_deg",)),
        "angles of joints: 2",
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
    "links in cm": (scaled("links", 100.0), "would be metres|--links="),
    "length in cm": (scaled("length", 100.0), "would be metres|--length="),
    "length in inch": (scaled("length", 1 / 0.0254), "would be metres|--length="),
    "no length": (lambda bench: replace(bench, length=None), "Measure it"),
    "no base": (lambda bench: replace(bench, base=None), "--base="),
    "base off in x": (shifted(0.3, 0.0), "--base="),
    "base off in y": (shifted(0.0, 0.3), "--base="),
    "base off by 6 cm": (shifted(-0.06, 0.0), "--base="),
    "fps half": (lambda bench: bench.with_rate(0.5), "--fps=?.?200"),
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
}
# of what one point shows nothing
NEEDS_TWO_POINTS = {"tip and mid exchanged"}
