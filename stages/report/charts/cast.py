"""Charts of casts: paths, distances, matching rates, and parameters over the casts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stringcast.data.artifacts import JOINTS
from stringcast.data.estimates import Estimate
from stringcast.stages.common import MM_PER_M, rms
from stringcast.stages.hit_test import MAX_GAP_S
from stringcast.stages.model.parameter import Parameter
from stringcast.stages.report.charts.axes import (
    OBSTACLE_STYLE,
    TARGET_STYLE,
    add_legend_above,
    draw_box,
    draw_map,
    label_decades,
    new_axes,
)
from stringcast.stages.report.formatting import format_count, format_mm, format_value
from stringcast.stages.report.parts import Chart, Line
from stringcast.stages.report.records import CastRecord, RunRecord
from stringcast.stages.report.theme import MS_PER_S, Picture, svg_picture

STATES = ("before", "after")  # estimation

# --- paths in the plane


def cast_path_picture(record: RunRecord, cast: CastRecord) -> Picture | None:
    """Draw the paths of hand and tip, and the arm at start and closest approach."""
    arm_table = cast.trial.arm
    if arm_table.empty:
        return None
    figure, axes = _plane_with_boxes(record)
    joints = cast.joint_positions(record.model.arm) * MM_PER_M
    closest = cast.verdict.t if np.isfinite(cast.verdict.t) else cast.motion.duration
    closest_tick = int(np.argmin(np.abs(arm_table["t"].to_numpy() - closest)))
    for tick, alpha in ((0, 0.35), (closest_tick, 1.0)):
        axes.plot(*joints[tick].T, "-o", color="soft", lw=3, ms=4, alpha=alpha)
    hand = joints[:, -1]
    axes.plot(*hand.T, color="after", label="hand")
    tip = cast.tip_path(np.arange(0, cast.motion.duration, 0.001)) * MM_PER_M
    if np.isfinite(tip).any():
        axes.plot(*tip.T, color="measured", lw=1, label="string's tip")
    add_legend_above(figure, 6)
    length = format_mm(float(np.hypot(*np.diff(hand, axis=0).T).sum() / MM_PER_M))
    words = (
        f"Path of the hand, {length} long, and of the tip; {_describe_target(record)}."
    )
    return svg_picture(figure, words)


def hand_paths_picture(record: RunRecord) -> Picture | None:
    """Draw the path of the hand in each cast, the first faintest."""
    if any(cast.trial.arm.empty for cast in record.casts):
        return None
    figure, axes = _plane_with_boxes(record)
    count = len(record.casts)
    for number, cast in enumerate(record.casts, start=1):
        hand = cast.joint_positions(record.model.arm)[:, -1] * MM_PER_M
        strength = (number - 1) / (count - 1)
        axes.plot(
            *hand.T,
            color="after",
            label=f"cast {number}" if number in (1, count) else None,
            alpha=0.25 + 0.75 * strength,
            lw=1 + strength,
        )
    axes.plot(*np.array(record.model.arm.base) * MM_PER_M, "s", ms=6, color="soft")
    add_legend_above(figure, 6)
    words = f"Path of the hand in {count} casts; {_describe_target(record)}."
    return svg_picture(figure, words)


def _plane_with_boxes(record: RunRecord) -> tuple[Figure, Axes]:
    """Create axes with target and obstacles to scale."""
    figure, axes = new_axes(5.4, 4.9)
    axes.margins(0.08)
    axes.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal", adjustable="datalim")
    draw_box(axes, record.target, label="target", **TARGET_STYLE)
    for number, obstacle in enumerate(record.obstacles):
        label = None if number else "obstacle"
        draw_box(axes, obstacle, label=label, **OBSTACLE_STYLE)
    return figure, axes


def _describe_target(record: RunRecord) -> str:
    count = len(record.obstacles)
    obstacles = f" and {format_count(count, 'obstacle')}" if count else ""
    target = record.target
    return (
        f"target at ({target.x * MM_PER_M:.0f}, {target.y * MM_PER_M:.0f}) "
        f"mm{obstacles}"
    )


# --- over time
JOINT_COLOURS = ("after", "before", "measured")  # from the base


def joint_charts(cast: CastRecord) -> list[Chart]:
    """Chart the joint angles, commanded and measured, and their difference."""
    commanded, measured = cast.motion.commands, cast.trial.arm
    t = measured["t"].to_numpy()
    angles, differences = [], []
    for joint, colour in zip(JOINTS, JOINT_COLOURS, strict=True):
        command = np.interp(t, commanded["t"], commanded[joint])
        angle = measured[joint].to_numpy()
        angles += [
            Line(joint, np.degrees(angle), colour),
            Line(f"{joint} commanded", np.degrees(command), "ink", dashed=True),
        ]
        differences.append(Line(joint, np.degrees(angle - command), colour))
    caption = "Joint 1 is at the base. Dashed: commanded."
    charts = [
        Chart("Joint angles", t, angles, "angle [°]", caption, low=None),
        Chart(
            "Tracking error of the joints", t, differences, "difference [°]", low=None
        ),
    ]
    return [mark_movement(chart, cast) for chart in charts]


def mark_movement(chart: Chart, cast: CastRecord) -> Chart:
    """Mark the arm's movement and the closest approach in a chart."""
    return replace(chart, moving=(0.0, cast.motion.duration), mark=cast.verdict.t)


def break_at_gaps(t: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Set values at times [s] to NaN after long gaps, to break lines there."""
    return np.where(np.diff(t, prepend=t[:1]) > MAX_GAP_S, np.nan, values)


def matching_chart(estimate: Estimate | None, title: str) -> Chart | None:
    """Chart E_f before and after an estimation in its last trial."""
    if estimate is None or estimate.matching.empty:
        return None
    table = estimate.matching
    table = table[table["trial"] == table["trial"].iloc[-1]].sort_values("t")
    t = table["t"].to_numpy()
    lines = []
    for state in STATES:
        rates = break_at_gaps(t, table[state].to_numpy())
        lines.append(Line(f"{state} estimation", rates, state))
    caption = "Agreement of simulation and camera in each frame; 1 is perfect."
    return Chart(title, t, lines, "matching rate E", caption)


# --- distance of simulated and measured string
DISTANCE_COLOURS = colormaps["viridis"].resampled(24)  # more would double the picture


def distances(
    record: RunRecord, cast: CastRecord, simulated: np.ndarray
) -> pd.DataFrame:
    """Return the distance of measured points from a simulated string (F, n, 2) [m].

    The columns are frame, s [m] and distance [m] at the same arc length.
    """
    string = record.model.string
    lines = cast.centre_lines
    frame = np.repeat(list(lines), [len(line) for line in lines.values()])
    points = np.concatenate(list(lines.values()))
    s = points[:, 2]
    place = np.clip(s / string.segment_length, 0, string.points - 1)
    first = np.minimum(place.astype(int), string.points - 2)
    share = (place - first)[:, None]
    on_string = (1 - share) * simulated[frame, first] + share * simulated[
        frame, first + 1
    ]
    distance = np.hypot(*(on_string - points[:, :2]).T)
    return pd.DataFrame({"frame": frame, "s": s, "distance": distance})


def distance_scale_end(record: RunRecord) -> float:
    """Return the end [m] of the colour scale of all casts.

    It is the 99.5 % quantile of the distances after estimation.
    """
    read = [cast for cast in record.casts if cast.centre_lines]
    after = [distances(record, cast, cast.after) for cast in read]
    if not after:
        return 0.0
    return float(pd.concat(after)["distance"].quantile(0.995))


def distance_map(
    record: RunRecord, cast: CastRecord, scale_end: float
) -> Picture | None:
    """Map the distance after estimation over arc length and time.

    Cells are means of one or more frames; unread frames stay empty.
    """
    if not cast.centre_lines:
        return None
    table = distances(record, cast, cast.after)
    figure, axes = new_axes(5.4, 2.6)
    drawn = draw_map(
        axes,
        table["s"].to_numpy(),
        cast.frame_times[table["frame"]],
        table["distance"].to_numpy() * MM_PER_M,
        record.model.string.length,
        cmap=DISTANCE_COLOURS,
        vmin=0,
        vmax=scale_end * MM_PER_M,
    )
    axes.set(xlabel="time [ms]", ylabel="arc length [mm]")
    bar = figure.colorbar(drawn, ax=axes, aspect=20, label="distance [mm]", pad=0.02)
    assert bar.solids is not None
    bar.solids.set_rasterized(True)  # each step would be a path
    end = cast.motion.duration * MS_PER_S
    axes.axvspan(0, end, color="axis", alpha=0.16, lw=0)
    if np.isfinite(cast.verdict.t):
        axes.axvline(cast.verdict.t * MS_PER_S, color="target", lw=1.2, ls="--")
    size = format_mm(rms(table["distance"]), 1)
    words = (
        f"Distance between simulated and measured string after estimation: RMS {size}."
    )
    return svg_picture(figure, words)


def distance_chart(record: RunRecord, cast: CastRecord) -> Chart | None:
    """Chart the rms distance over the string before and after estimation."""
    if not cast.centre_lines:
        return None
    lines = []
    for state, simulated in zip(STATES, (cast.before, cast.after), strict=True):
        table = distances(record, cast, simulated)
        squares = (table["distance"] ** 2).groupby(table["frame"]).mean()
        squares = squares.reindex(range(len(cast.frame_times)))
        by_frame = np.sqrt(squares.to_numpy()) * MM_PER_M
        lines.append(Line(f"{state} estimation", by_frame, state))
    caption = (
        "Root mean square over the string. Gaps are frames that could not be read. "
        "Shaded: the arm moves."
    )
    chart = Chart("Distance over time", cast.frame_times, lines, "RMS [mm]", caption)
    return mark_movement(chart, cast)


# --- over the casts
def history_picture(parameter: Parameter, estimates: Sequence[Estimate]) -> Picture:
    """Draw the estimates of a parameter, starting with the start value (0).

    Bars are 95 % intervals; hollow marks are values not determined by the data.
    """
    tables = [estimate.parameters.set_index("name") for estimate in estimates]
    known = [n for n, table in enumerate(tables) if parameter.name in table.index]
    rows = pd.DataFrame([tables[n].loc[parameter.name] for n in known])
    numbers = np.array(known) + 1
    figure, axes = new_axes(2.5, 1.55)
    lowest, highest = rows["minimum"].min(), rows["maximum"].max()
    axes.axhspan(lowest, highest, color="axis", alpha=0.16, lw=0)
    values = [parameter.start, *rows["value"]]
    axes.plot([0, *numbers], values, color="after", lw=1.2)
    axes.vlines(numbers, rows["low"], rows["high"], color="after", lw=4, alpha=0.35)
    fills = np.where(rows["determined"], "after", "none").tolist()
    axes.scatter(numbers, rows["value"], 25, fills, edgecolors="after", zorder=3)
    if lowest > 0:
        axes.set_yscale("log")
        label_decades(axes.yaxis)
    else:
        axes.ticklabel_format(axis="y", scilimits=(-2, 4))
    axes.set(xticks=range(len(tables) + 1), xlim=(-0.3, len(tables) + 0.3))
    axes.set_xlabel("estimation", fontsize=8)
    last = rows.iloc[-1]
    suffix = "" if last["determined"] else ", not determined by the data"
    words = (
        f"{parameter.name.replace('_', ' ')} from {format_value(parameter.start)} at "
        f"the start to {format_value(last['value'])} {parameter.unit} after "
        f"{format_count(len(tables), 'estimation')}{suffix}."
    )
    return svg_picture(figure, words)
