"""Strings, hands and tips in the plane of motion."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from stringcast.stages.model.box import Box
from stringcast.stages.report.formatting import mm, ms, plain
from stringcast.stages.report.records import (
    EXPERIMENT_LABELS,
    Cast,
    DiagnosisRecord,
    PaperFigure,
    PaperRecord,
    RunRecord,
    away,
)
from stringcast.stages.report.theme import (
    LIGHT_COLOURS,
    MM_PER_M,
    Picture,
    framed,
    vector,
)

# --- a cast
SIZE = (5.4, 4.9)  # [in] of a drawing of strings


def path(record: RunRecord, cast: Cast) -> Picture | None:
    """One manipulation: the ways of hand and tip, the arm at the start and at the
    closest approach.
    """
    if cast.trial.arm.empty:
        return None
    figure, axes = _plane_of(record)
    joints = cast.joints(record.model.arm) * MM_PER_M
    closest = cast.verdict.t if np.isfinite(cast.verdict.t) else cast.motion.duration
    for frame, alpha in (
        (0, 0.35),
        (int(np.argmin(np.abs(cast.trial.arm["t"].to_numpy() - closest))), 1.0),
    ):
        axes.plot(
            *joints[frame].T, "-o", color=LIGHT_COLOURS["soft"], lw=3, ms=4, alpha=alpha
        )
    axes.plot(*joints[:, -1].T, color=LIGHT_COLOURS["after"], label="hand")
    way = cast.tip(np.arange(0, cast.motion.duration, 0.001)) * MM_PER_M
    if np.isfinite(way).any():
        axes.plot(*way.T, color=LIGHT_COLOURS["measured"], lw=1, label="string's tip")
    _legend_above(figure, axes)
    length = float(np.hypot(*np.diff(joints[:, -1], axis=0).T).sum() / MM_PER_M)
    return vector(
        figure,
        f"Path of the hand, {mm(length)} long, and of the tip; {_where(record)}.",
    )


def paths(record: RunRecord) -> Picture | None:
    """The hand's way in each manipulation, dark to bright."""
    casts = [cast for cast in record.casts if not cast.trial.arm.empty]
    if len(casts) < 2:
        return None
    figure, axes = _plane_of(record)
    for number, cast in enumerate(record.casts, start=1):
        hand = cast.joints(record.model.arm)[:, -1] * MM_PER_M
        share = (number - 1) / max(len(record.casts) - 1, 1)
        axes.plot(
            *hand.T,
            color=LIGHT_COLOURS["after"],
            alpha=0.25 + 0.75 * share,
            lw=1 + share,
            label=f"cast {number}",
        )
    axes.plot(
        *np.array(record.model.arm.base) * MM_PER_M,
        "s",
        ms=6,
        color=LIGHT_COLOURS["soft"],
    )
    _legend_above(figure, axes)
    return vector(figure, f"Way of the hand in {len(casts)} casts; {_where(record)}.")


def _plane_of(record: RunRecord) -> tuple[Figure, Axes]:
    """Target and obstacles, to scale."""
    figure = framed(*SIZE)
    axes = figure.subplots()
    axes.margins(0.08)
    axes.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal", adjustable="datalim")
    axes.add_patch(
        _box(
            record.target,
            fill=False,
            edgecolor=LIGHT_COLOURS["target"],
            lw=1.8,
            label="target",
        )
    )
    for obstacle in record.obstacles:
        axes.add_patch(
            _box(
                obstacle,
                facecolor=LIGHT_COLOURS["wall"],
                alpha=0.5,
                lw=0,
                label="obstacle",
            )
        )
    return figure, axes


def _box(box: Box, **style: Any) -> Rectangle:
    corner = ((box.x - box.w / 2) * MM_PER_M, (box.y - box.h / 2) * MM_PER_M)
    return Rectangle(corner, box.w * MM_PER_M, box.h * MM_PER_M, **style)


def _legend_above(figure: Figure, axes: Axes) -> None:
    """Above the axes, every label once."""
    once = dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    figure.legend(once.values(), once.keys(), loc="upper left", ncols=6)
    # [inches]
    figure.subplots_adjust(top=1 - (0.1 + 0.18 * np.ceil(len(once) / 6)) / SIZE[1])


def _where(record: RunRecord) -> str:
    walls = len(record.obstacles)
    around = f" and {walls} obstacle{'s' if walls > 1 else ''}" if walls else ""
    return f"target at ({record.target.x * MM_PER_M:.0f}, {record.target.y * MM_PER_M:.0f}) mm{around}"


# --- a diagnosis
# quantile along the string that says how wrong a frame is: a few outliers do not
FAR = 0.75


def worst(table: pd.DataFrame) -> pd.DataFrame:
    """Rows of the frame of a trial in which the base model is furthest off, against
    what may be doubted.
    """
    ratios = pd.Series(
        away(table, "base") / table["doubt"].to_numpy(), index=table.index
    )
    moment = ratios.groupby(table["t"]).quantile(FAR).idxmax()
    return table[table["t"] == moment].sort_values("s")


SIZE_OF_FILM = 420  # [px] of the longer side
EDGE = 24  # [px] left free around the strings, and for the line that shows the scale
NUMBERS = 60_000  # coordinates in all films of a page: 0.3 MB


def film(record: DiagnosisRecord, table: pd.DataFrame) -> dict[str, Any]:
    """Strings of a trial and the ways of their tips, measured and simulated; begins
    where the base model is worst.
    """
    names = {"measured": ("x", "y")} | {
        model: (f"{model}_x", f"{model}_y") for model in record.models
    }
    points = np.concatenate(
        [table[list(columns)].to_numpy() for columns in names.values()]
    )
    low, high = points.min(axis=0), points.max(axis=0)
    metre = (SIZE_OF_FILM - 2 * EDGE) / max(float((high - low).max()), 1e-3)
    size = (high - low) * metre + 2 * EDGE
    every = -(-2 * len(points) * len(record.trials) // NUMBERS)
    frames = {t: rows.sort_values("s") for t, rows in table.groupby("t")}
    begin = float(worst(table)["t"].iloc[0])
    times = [t for i, t in enumerate(frames) if i % every == 0 or t == begin]

    def pixels(rows: pd.DataFrame, columns: tuple[str, str]) -> list[list[float]]:
        x, y = ((rows[list(columns)].to_numpy() - low) * metre + EDGE).T
        return np.round(np.stack([x, size[1] - y], axis=-1), 1).tolist()

    return {
        "width": round(size[0]),
        "height": round(size[1]),
        "metre": metre,
        "t": [round(t * MM_PER_M, 1) for t in times],
        "start": times.index(begin),
        "boxes": [],
        "stills": [],
        "strings": {
            name: [pixels(frames[t], columns) for t in times]
            for name, columns in names.items()
        },
        "ways": {name: pixels(last(table), columns) for name, columns in names.items()},
    }


NEAR = 0.05  # of the length measured: a point as near to the end stands for the tip


def last(table: pd.DataFrame) -> pd.DataFrame:
    """The outermost point of each frame in which the tip was seen, in the order of
    time.
    """
    ends = table.loc[table.groupby("t")["s"].idxmax()]
    return ends[ends["s"] >= (1 - NEAR) * table["s"].max()].sort_values("t")


# --- the motion proposed
# the likeliest hypothesis first
COLOURS_OF_HYPOTHESES = ("after", "before", "measured", "target")
DASHES = ("-", "--", "-.", ":")


def proposed(record: DiagnosisRecord) -> Picture | None:
    """The strings of the hypotheses where they are farthest apart, and their distance
    over time; None where no motion is proposed.
    """
    table = record.diagnosis.predicted
    if table.empty:
        return None
    hypotheses = {
        str(name): rows.reset_index(drop=True)
        for name, rows in table.groupby("hypothesis", sort=False)
    }
    likeliest, first = next(iter(hypotheses.items()))
    # the largest distance from the likeliest anywhere on the string [m], by time
    apart = {}
    for name, rows in list(hypotheses.items())[1:]:
        distance = pd.Series(np.hypot(rows["x"] - first["x"], rows["y"] - first["y"]))
        apart[name] = distance.groupby(first["t"].to_numpy()).max()
    closest = min(apart, key=lambda name: float(apart[name].max()))
    t = float(apart[closest].idxmax())

    figure = Figure(figsize=(7.2, 3.2))
    left, right = figure.subplots(1, 2)
    for (name, rows), colour, style in zip(
        hypotheses.items(), COLOURS_OF_HYPOTHESES, DASHES, strict=False
    ):
        now = rows[rows["t"] == t].sort_values("s")
        left.plot(
            now["x"] * MM_PER_M,
            now["y"] * MM_PER_M,
            style,
            marker=".",
            ms=4,
            color=LIGHT_COLOURS[colour],
            label=plain(name),
        )
    left.set(
        xlabel="x [mm]",
        ylabel="y [mm]",
        title=f"at {ms(t)}",
        aspect="equal",
        adjustable="datalim",
    )
    for way, colour, style in zip(
        apart.values(), COLOURS_OF_HYPOTHESES[1:], DASHES[1:], strict=False
    ):
        right.plot(
            way.index * MM_PER_M,
            way * MM_PER_M,
            style,
            lw=1.2,
            color=LIGHT_COLOURS[colour],
        )
    floor = float(record.diagnosis.residuals["sigma"].median() * MM_PER_M)
    right.axhspan(0, floor, color=LIGHT_COLOURS["grid"], lw=0)
    right.annotate(
        "noise floor",
        (1, floor),
        xycoords=("axes fraction", "data"),
        ha="right",
        va="bottom",
        fontsize=8,
    )
    right.set(xlabel="time [ms]", ylabel="apart, at most [mm]", ylim=(0, None))
    right.axvline(t * MM_PER_M, color=LIGHT_COLOURS["axis"], lw=1)
    figure.legend(*left.get_legend_handles_labels(), loc="outside upper left", ncols=4)
    most = ", ".join(
        f"{plain(name)} {mm(float(way.max()), 1)}" for name, way in apart.items()
    )
    return vector(
        figure,
        f"The proposed motion at {ms(t)}; away from {plain(likeliest)} at most: {most}.",
    )


# --- the paper's experiments
LOOK: dict[str, dict[str, Any]] = {
    "arm": {"color": LIGHT_COLOURS["soft"], "lw": 2.2, "marker": "o", "ms": 3},
    "foretold": {"color": LIGHT_COLOURS["before"], "lw": 1.5, "ls": (0, (3, 1.5))},
    "measured": {"color": LIGHT_COLOURS["measured"], "lw": 1.7},
}
CALLED = {"arm": "arm", "foretold": "string, simulated", "measured": "string, filmed"}


def shapes(record: PaperRecord, casts: Sequence[tuple[str, int]]) -> PaperFigure | None:
    """A panel a cast. casts: experiment and number of the manipulation."""
    if not casts:
        return None
    figure = Figure(figsize=(2.75 * max(len(casts), 2), 3.5))
    panels = np.atleast_1d(figure.subplots(1, len(casts), sharex=True, sharey=True))
    for axes, (condition, number) in zip(panels, casts, strict=True):
        lines = record.cast("lines", condition, number)
        last = lines["moment"].max()
        # fainter the earlier
        for (moment, kind), line in lines.groupby(["moment", "kind"]):
            share = 0.25 + 0.75 * (moment / last) ** 2
            faint = share if kind != "arm" else 0.5 * share
            label = CALLED[kind] if moment == last else None
            axes.plot(
                line["x"] * MM_PER_M,
                line["y"] * MM_PER_M,
                alpha=faint,
                label=label,
                **LOOK[kind],
            )
        boxes(axes, record.of("boxes", condition))
        axes.set(xlabel="x [mm]", aspect="equal")
        axes.locator_params(nbins=5)
        axes.set_title(_title(record, condition, number), fontsize=8.5)
    panels[0].set_ylabel("y [mm]")
    handles = dict(zip(*reversed(panels[0].get_legend_handles_labels()), strict=True))
    kinds = [name for name in CALLED.values() if name in handles]  # in this order
    figure.legend(
        [handles[name] for name in kinds], kinds, loc="outside upper left", ncols=3
    )
    said = [_title(record, *cast).replace("\n", ", ") for cast in casts]
    return PaperFigure(figure, f"Drawn are {'; '.join(said)}.")


def boxes(axes: Axes, of: pd.DataFrame) -> None:
    """Target and obstacles. of: table boxes."""
    for box in of.itertuples():
        target = box.kind == "target"
        look: dict[str, Any] = {"fc": LIGHT_COLOURS["wall"], "alpha": 0.5}
        look = (
            {"fill": False, "ec": LIGHT_COLOURS["target"], "lw": 1.6}
            if target
            else look
        )
        axes.add_patch(_box(Box(box.x, box.y, box.w, box.h), zorder=3, **look))


def _title(record: PaperRecord, condition: str, number: int) -> str:
    verdict = record.verdict(condition, number)
    ended = "hit" if verdict["hit"] else f"missed by {mm(verdict['miss_m'])}"
    return f"{EXPERIMENT_LABELS[condition]}\nmanipulation {number}, {ended}"


TARGETS = ("after", "before", "measured")


def trajectories(record: PaperRecord, conditions: Sequence[str]) -> PaperFigure | None:
    """The last cast of each experiment; a dot where the hand starts."""
    there = [name for name in conditions if record.casts(name)]
    if not there:
        return None
    figure = Figure(figsize=(5.4, 4.9))
    axes = figure.subplots()
    rises = []
    for name, colour in zip(there, TARGETS, strict=False):
        hand = record.cast("hands", name, record.casts(name)[-1]).sort_values("t")
        x, y = hand["x"].to_numpy() * MM_PER_M, hand["y"].to_numpy() * MM_PER_M
        axes.plot(x, y, color=LIGHT_COLOURS[colour], label=EXPERIMENT_LABELS[name])
        axes.plot(x[0], y[0], "o", color=LIGHT_COLOURS[colour], ms=5)
        boxes(axes, record.of("boxes", name))
        rises.append(
            f"{EXPERIMENT_LABELS[name]}: the hand ends {abs(y[-1] - y[0]):.0f} mm {'above' if y[-1] > y[0] else 'below'}"
        )
    axes.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal", adjustable="datalim")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper left", ncols=3)
    return PaperFigure(figure, f"Ways of the hand. {'; '.join(rises)} its start.")
