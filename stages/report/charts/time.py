"""Charts over time, and from cast to cast."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stringcast.data.artifacts import JOINTS, Estimate
from stringcast.stages.hit_test import MAX_GAP_S
from stringcast.stages.report.formatting import mm, rate
from stringcast.stages.report.page import Chart, Line
from stringcast.stages.report.records import (
    TRIALS,
    Cast,
    DiagnosisRecord,
    PaperFigure,
    PaperRecord,
    RunRecord,
)
from stringcast.stages.report.theme import (
    LIGHT_COLOURS,
    MM_PER_M,
    Picture,
    framed,
    vector,
)


def broken(t: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values over times [s], NaN after each gap too long to draw a line across."""
    return np.where(np.diff(t, prepend=t[:1]) > MAX_GAP_S, np.nan, values)


def mark_movement(axes: Axes, cast: Cast) -> None:
    """Shade the arm's movement and mark the closest approach. The axis is in ms."""
    axes.axvspan(
        0,
        cast.motion.duration * MM_PER_M,
        color=LIGHT_COLOURS["axis"],
        alpha=0.16,
        lw=0,
    )
    if np.isfinite(cast.verdict.t):
        axes.axvline(
            cast.verdict.t * MM_PER_M,
            color=LIGHT_COLOURS["target"],
            lw=1.2,
            ls="--",
            label="closest approach",
        )


# --- a cast
COLOURS = ("after", "before", "measured")  # of the joints, from the base


def joints(cast: Cast) -> list[Chart]:
    """The angles commanded (dashed) and measured, and their difference; none where the
    arm reported no angles.
    """
    commanded, measured = cast.motion.commands, cast.trial.arm
    if measured.empty:
        return []
    t, lines, behind, largest = measured["t"].to_numpy(), [], [], []
    for joint, colour in zip(JOINTS, COLOURS, strict=True):
        wanted = np.interp(t, commanded["t"], commanded[joint])
        away = np.degrees(measured[joint].to_numpy() - wanted)
        lines += [Line(joint, np.degrees(measured[joint].to_numpy()), colour)]
        lines += [Line(f"{joint} commanded", np.degrees(wanted), "ink", dashed=True)]
        behind += [Line(joint, away, colour)]
        largest += [f"{joint} {np.abs(away).max():.1f}°"]
    words = f"Joint angles, commanded and measured; largest differences {', '.join(largest)}."
    caption = "Joint 1 is at the base. Dashed: commanded."
    less = f"Joint angles, measured less commanded; at most {', '.join(largest)}."
    return [
        Chart(
            "Joint angles",
            t,
            lines,
            "angle [°]",
            words,
            caption,
            moving(cast),
            cast.verdict.t,
            None,
        ),
        Chart(
            "Joints behind their commands",
            t,
            behind,
            "difference [°]",
            less,
            "",
            moving(cast),
            cast.verdict.t,
            None,
        ),
    ]


def moving(cast: Cast) -> tuple[float, float]:
    """While the arm is commanded to move [s]."""
    return 0.0, float(cast.motion.duration)


def matching(
    estimate: Estimate | None,
    cast: Cast | None = None,
    title: str = "Matching rate over time",
) -> Chart | None:
    """E_f before and after an estimation, in the newest of the trials it saw."""
    if estimate is None or estimate.matching.empty:
        return None
    table = estimate.matching
    table = table[table["trial"] == table["trial"].iloc[-1]].sort_values("t")
    t = table["t"].to_numpy()
    lines = [
        Line(f"{name} estimation", broken(t, table[name].to_numpy()), name)
        for name in ("before", "after")
    ]
    means = [rate(float(np.nanmean(table[name]))) for name in ("before", "after")]
    words = f"Matching rate over time: on average {means[0]} before estimation, {means[1]} after."
    caption = "How well simulation and camera agree, frame by frame; 1 is perfect."
    shaded = (moving(cast), cast.verdict.t) if cast else (None, None)
    return Chart(
        title,
        t,
        lines,
        "E_f [1]",
        words,
        caption + " Shaded: the arm moves." * bool(cast),
        *shaded,
    )


# --- from cast to cast
def progress(record: RunRecord) -> Picture | None:
    """The closest approach of each cast (filled: a hit), and E before and after its
    estimation.
    """
    if len(record.casts) < 2:
        return None
    figure = framed(5.4, 4.9)
    top, bottom = figure.subplots(2, 1, sharex=True)
    distances = np.array([cast.verdict.distance for cast in record.casts]) * MM_PER_M
    number = np.arange(1, len(distances) + 1)
    hits = np.array([cast.verdict.hit for cast in record.casts])
    top.plot(number, distances, color=LIGHT_COLOURS["target"])
    for these, words, fill in (
        (~hits, "missed", "none"),
        (hits, "hit", LIGHT_COLOURS["target"]),
    ):
        if these.any():
            top.plot(
                number[these],
                distances[these],
                "o",
                color=LIGHT_COLOURS["target"],
                label=words,
                mfc=fill,
            )
    top.set(ylabel="closest to centre [mm]", ylim=(0, None))

    for at, cast in enumerate(record.casts, start=1):
        if cast.estimate is not None:
            rates = cast.estimate.fit.iloc[0][["before", "after"]].astype(float)
            bottom.plot([at, at], rates, color=LIGHT_COLOURS["axis"], lw=1.2, zorder=1)
            for name in ("before", "after"):
                label = f"{name} estimation" if at == 1 else ""
                bottom.plot(
                    at, rates[name], "o", color=LIGHT_COLOURS[name], label=label
                )
    bottom.set(xlabel="cast", ylabel="matching rate E [1]", ylim=(0, 1.02))
    bottom.set_xticks(range(1, len(record.casts) + 1))
    bottom.set_xlim(0.6, len(record.casts) + 0.4)
    figure.legend(loc="upper left", ncols=4)
    closest = ", ".join(mm(cast.verdict.distance) for cast in record.casts)
    return vector(
        figure,
        f"Closest approach of the tip to the target's centre, cast by cast: {closest}.",
    )


# --- a diagnosis
LONGEST = 0.28  # [inch] an arrow


def missing(record: DiagnosisRecord) -> Picture | None:
    """A row for each trial: arrows over time and arc length."""
    table = record.diagnosis.missing.assign(size=lambda t: np.hypot(t["x"], t["y"]))
    if table.empty:
        return None
    shown = list(
        table.groupby("trial")["size"].max().sort_values(ascending=False).index[:TRIALS]
    )
    rows = table[table["trial"].isin(shown)].groupby("trial")
    figure = Figure(figsize=(6.0, 0.7 + 1.25 * len(rows)))
    panels = figure.subplots(len(rows), 1, sharex=True, sharey=True, squeeze=False)[
        :, 0
    ]
    per_inch = float(table["size"].max()) / LONGEST
    for axes, (trial, part) in zip(panels, rows, strict=True):
        place = (part["t"] * MM_PER_M, part["s"] * MM_PER_M)
        axes.plot(*place, ".", ms=1.5, color=LIGHT_COLOURS["axis"])
        # angles: arrows point as the displacement does in the plane, x to the right and
        # y up, whatever the axes' scales
        look: dict[str, Any] = {
            "angles": "uv",
            "scale_units": "inches",
            "scale": per_inch,
            "width": 0.0022,
        }
        axes.quiver(*place, part["x"], part["y"], color=LIGHT_COLOURS["target"], **look)
        axes.margins(0.06, 0.3)
        axes.set_ylabel("s [mm]")
        axes.text(
            1.0,
            1.0,
            trial,
            transform=axes.transAxes,
            ha="right",
            va="bottom",
            color=LIGHT_COLOURS["soft"],
        )
    panels[-1].set_xlabel("time [ms]")
    top = table.loc[table["size"].idxmax()]
    words = f"at most {mm(top['size'], 1)} in trial {top['trial']} at {top['t'] * MM_PER_M:.0f} ms"
    return vector(
        figure,
        f"The unexplained displacement of the string over time in {len(rows)} trials; {words}.",
    )


def latent(record: DiagnosisRecord, trial: str) -> Chart | None:
    """The unexplained displacement in a trial over time: the largest displacement
    anywhere on the string.
    """
    table = record.diagnosis.missing
    part = table[table["trial"] == trial]
    if part.empty:
        return None
    largest = np.hypot(part["x"], part["y"]).groupby(part["t"]).max() * MM_PER_M
    lines = [Line("largest along the string", largest.to_numpy(), "target")]
    return Chart(
        "Unexplained",
        largest.index.to_numpy(),
        lines,
        "[mm]",
        f"What nothing explains in trial {trial}.",
    )


# --- Fig. 14 of the paper
LATER = 4  # the manipulation that the paper compares with the first
# [s] each side of the closest approach, over which E_f is averaged for comparison
AROUND = 0.05


def fig_14(record: PaperRecord, condition: str) -> PaperFigure | None:
    """E_f with the parameters with which each motion was made; dashed: the closest
    approach.
    """
    made = [
        number
        for number in record.casts(condition)
        if len(record.cast("matching", condition, number))
    ]
    if not made:
        return None
    figure = Figure(figsize=(5.4, 3.0))
    axes = figure.subplots()
    near: dict[int, float] = {}
    # the fourth, or the last before it
    beside = max(number for number in made if number <= LATER)
    for number, colour in zip(
        dict.fromkeys([made[0], beside]), ("before", "after"), strict=False
    ):
        table = record.cast("matching", condition, number).sort_values("t")
        t, rates = table["t"].to_numpy(), table["before"].to_numpy()
        axes.plot(
            t * MM_PER_M,
            broken(t, rates),
            color=LIGHT_COLOURS[colour],
            label=f"manipulation {number}",
        )
        closest = record.verdict(condition, number)["t_closest"]
        axes.axvline(closest * MM_PER_M, color=LIGHT_COLOURS[colour], lw=1, ls="--")
        near[number] = float(
            np.nanmean(table.loc[(table["t"] - closest).abs() <= AROUND, "before"])
        )
    axes.set(xlabel="time [ms]", ylabel="matching rate E$_f$ [1]", ylim=(0, 1.02))
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper left", ncols=2)
    said = ", ".join(
        f"{rate(mean)} in manipulation {number}" for number, mean in near.items()
    )
    first, last = next(iter(near.values())), list(near.values())[-1]
    grew = (
        ""
        if len(near) < 2
        else ": higher, as in the paper"
        if last > first
        else ": not higher, unlike in the paper"
    )
    return PaperFigure(
        figure, f"Around the closest approach, 50 ms each side, E is {said}{grew}."
    )
