"""The data of the figures, as tables: of each experiment one run, neither lucky nor
unlucky, and results of all runs.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from stringcast.data.artifacts import ARM, JOINTS, Estimate, Motion, Points
from stringcast.data.file_checks import read_json
from stringcast.data.schema import Column, Table
from stringcast.data.store import load, read_table
from stringcast.pipeline.paper.scores import median
from stringcast.pipeline.settings.typed_settings import build_dataclass
from stringcast.stages.model.arm import Arm

MOMENTS = 5  # at which strings are drawn, from the start to the closest approach
CAST = (
    Column("condition", "", "experiment of conf/experiment/paper.yaml", "text"),
    Column("seed", "1", "of the run", "int"),
    Column("manipulation", "1", "number of the cast", "int"),
)
_T = Column("t", "s", "time; 0 is the start of the movement")
_XY = (Column("x", "m", "position"), Column("y", "m", "position"))
LINES = Table(
    "lines",
    "strings and arm at some moments of the casts that are shown, the last at the closest approach",
    (
        *CAST,
        Column("moment", "1", "from 0", "int"),
        Column(
            "kind",
            "",
            "arm, measured, or foretold: as simulated when the motion was chosen",
            "text",
        ),
        _T,
        *_XY,
    ),
)
HANDS = Table(
    "hands",
    "the hand's way in the casts that are shown, by the joint angles measured",
    (*CAST, _T, *_XY),
)
MATCHING = Table(
    "matching",
    "E_f over time in the casts that are shown",
    (
        *CAST,
        _T,
        Column("before", "1", "with the parameters with which the motion was made"),
        Column("after", "1", "with those estimated from this cast"),
    ),
)
BOXES = Table(
    "boxes",
    "target and obstacles of the casts that are shown",
    (
        CAST[0],
        Column("kind", "", "target or obstacle", "text"),
        Column("x", "m", "centre"),
        Column("y", "m", "centre"),
        Column("w", "m", "full width"),
        Column("h", "m", "full height"),
    ),
)
PARAMETERS = Table(
    "parameters",
    "what the last estimation of each run found",
    (
        *CAST,
        Column("symbol", "", "as in the paper", "text"),
        Column("value", "", "in `unit`"),
        Column("unit", "", "as in the paper", "text"),
        Column("minimum", "", "of the range searched, in `unit`"),
        Column("maximum", "", "of the range searched, in `unit`"),
        Column("determined", "", "by this data", "bool"),
    ),
)
TABLES = (LINES, HANDS, MATCHING, BOXES)


def typical(of_runs: pd.DataFrame) -> pd.DataFrame:
    """The typical run of each experiment: of those done, the one of the lowest seed
    that needed the median number of manipulations.
    """
    done = of_runs[of_runs["state"] == "done"].sort_values("seed")
    middle = done.groupby("condition")["hit_at"].transform(
        lambda hit_at: median(hit_at.to_numpy())["median"]
    )
    return done[done["hit_at"] == middle].groupby("condition", sort=False).head(1)


def shown(
    folder: Path, chosen: pd.DataFrame, of_casts: pd.DataFrame
) -> dict[str, pd.DataFrame]:
    """Every table of TABLES by name. folder: the study's. chosen: `typical`. of_casts:
    table CASTS of `scores`.
    """
    parts: dict[str, list[pd.DataFrame]] = {table.name: [] for table in TABLES}
    for run in chosen.itertuples():
        settings = read_json(folder / run.folder / "config.json")
        arm = build_dataclass(Arm, settings["arm"], "arm", "config.json")
        obstacles = [
            {"kind": "obstacle", **box} for box in settings["obstacles"]["boxes"]
        ]
        boxes = pd.DataFrame([{"kind": "target", **settings["target"]}, *obstacles])
        parts[BOXES.name].append(boxes.assign(condition=run.condition))
        mine = of_casts[
            (of_casts["condition"] == run.condition) & (of_casts["seed"] == run.seed)
        ]
        for cast in mine.itertuples():
            place = folder / run.folder / "iterations" / f"{cast.manipulation:02d}"
            key = {
                "condition": run.condition,
                "seed": run.seed,
                "manipulation": cast.manipulation,
            }
            for name, frame in _cast(place, arm, cast.t_closest).items():
                parts[name].append(frame.assign(**key))
    return {
        t.name: t.check(pd.concat(parts[t.name])) if parts[t.name] else t.empty()
        for t in TABLES
    }


def parameters(folder: Path, of_runs: pd.DataFrame) -> pd.DataFrame:
    """Table PARAMETERS. of_runs: table RUNS of `scores`."""
    found = [
        read_table(Estimate.TABLES["parameters"], made[-1]).assign(
            condition=run.condition, seed=run.seed, manipulation=int(made[-1].parts[-3])
        )
        for run in of_runs.itertuples()
        if (
            made := sorted(
                (folder / run.folder).glob("iterations/*/estimate/parameters.parquet")
            )
        )
    ]
    names = [column.name for column in PARAMETERS.columns]
    return PARAMETERS.check(pd.concat(found)[names]) if found else PARAMETERS.empty()


def _cast(place: Path, arm: Arm, closest: float) -> dict[str, pd.DataFrame]:
    """Lines, way of the hand and matching rates of one cast, from its artifacts."""
    motion, seen = load(Motion, place / "motion"), load(Points, place / "points")
    measured = read_table(ARM, place / "trial" / "arm.parquet")
    until = closest if np.isfinite(closest) else motion.duration
    joints = arm.joint_positions(measured[list(JOINTS)].to_numpy())
    t = measured["t"].to_numpy()
    moving = (t >= 0) & (t <= motion.duration)
    hand = pd.DataFrame(
        {"t": t[moving], "x": joints[moving, -1, 0], "y": joints[moving, -1, 1]}
    )
    made = {"lines": pd.concat(_lines(motion, seen, t, joints, until)), "hands": hand}
    rates = place / "estimate" / "matching.parquet"
    if rates.exists():
        table = read_table(Estimate.TABLES["matching"], rates)
        made["matching"] = table[table["trial"] == table["trial"].iloc[-1]].drop(
            columns="trial"
        )
    return made


def _lines(
    motion: Motion, seen: Points, t: np.ndarray, joints: np.ndarray, until: float
) -> Iterator[pd.DataFrame]:
    """The lines drawn at each moment, each at its nearest time."""
    for moment, at in enumerate(np.linspace(0, until, MOMENTS)):
        arm = joints[np.argmin(np.abs(t - at))]
        lines = {
            "arm": pd.DataFrame({"x": arm[:, 0], "y": arm[:, 1]}),
            "measured": _nearest(seen.points, at),
            "foretold": _nearest(motion.string, at),
        }
        for kind, line in lines.items():
            yield line.assign(moment=moment, kind=kind, t=at)


def _nearest(points: pd.DataFrame, at: float) -> pd.DataFrame:
    """x and y of the points of the time nearest to `at`."""
    t = points["t"].to_numpy()
    near = points[t == t[np.argmin(np.abs(t - at))]] if len(t) else points
    return near.sort_values("s")[["x", "y"]]
