"""A figure of a measured trial that makes wrong units, axes and clocks visible."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter

from stringcast.stages.check.measured import CheckedTrial
from stringcast.stages.common import MM_PER_M
from stringcast.stages.model.interpolation import interpolate_rows
from stringcast.stages.model.polyline import step_lengths
from stringcast.stages.report.theme import MS_PER_S, STYLE_SHEET

POSE_COUNT = 5  # evenly over the time in which both arm and string are visible
LATER_POSE_OPACITY = 0.25
POSE_STYLES: dict[str, dict[str, Any]] = {
    "arm": {"color": "axis", "marker": "o", "ms": 3, "lw": 2.4},
    "string, as measured": {"color": "after", "marker": ".", "ms": 4, "lw": 1.2},
}


def trial_figure(
    seen: CheckedTrial, clock_profile: pd.DataFrame | None = None
) -> Figure:
    """Draw arm and string in the plane, and positions and speeds over time.

    If clocks were fitted, the profile of their offset is added.
    """
    end = seen.points.groupby("t").tail(1)
    t, tip = end["t"].to_numpy(), end[["x", "y"]].to_numpy()
    heights = [2, 1, 1] if clock_profile is None else [2, 1, 1, 1]
    with style.context(STYLE_SHEET):
        figure = Figure(figsize=(5.3, 8.0))  # narrow enough for a phone
        panels = figure.subplots(len(heights), height_ratios=heights)
        plane, places, speeds, *clocks = panels
        speeds.sharex(places)
        _draw_plane(plane, seen, t, tip)
        _draw_positions(places, seen, t, tip)
        _draw_speeds(speeds, seen, t, tip)
        if clock_profile is not None:
            _draw_clock_profile(clocks[0], clock_profile)
    return figure


def _draw_clock_profile(axes: Axes, profile: pd.DataFrame) -> None:
    """Draw the profile of the clock offset around its estimate.

    Its two sources are the stretch that the points would need, and the likelihood of
    the string model. The interval is shaded.
    """
    offset_ms = profile["offset"] * MS_PER_S
    stretch_mm = profile["stretch"] * MM_PER_M
    axes.plot(offset_ms, stretch_mm, color="axis", label="needed stretch")
    axes.set(xlabel="clock offset from estimate [ms]", ylabel="stretch [mm]")
    other = axes.twinx()
    log_likelihood = profile["log_likelihood"]
    other.plot(offset_ms, log_likelihood, color="after", label="string model")
    other.set_ylabel("log likelihood")
    other.yaxis.set_major_formatter(
        EngFormatter(sep="")
    )  # no power of ten at the end of the axis
    ends_ms = profile[["low", "high"]].iloc[0] * MS_PER_S
    axes.axvspan(*ends_ms, color="measured", alpha=0.3, label="95 % interval")
    drawn, _ = axes.get_legend_handles_labels()
    drawn += other.get_lines()
    axes.legend(handles=drawn, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))


def describe_trial(seen: CheckedTrial) -> str:
    """Describe a trial: frames, length of the string, and onsets of motion."""
    onsets = {"the hand": seen.hand_onset, "the string": seen.string_onset}
    starts = [f"{who} at {t:.2f} s" for who, t in onsets.items() if t is not None]
    moved = f"; {' and '.join(starts)} began to move" if starts else ""
    length = f"{seen.length * MM_PER_M:.0f} mm"
    return (
        f"Trial {seen.name}: {len(seen.frame_t)} frames of a string of {length}{moved}."
    )


def _draw_plane(axes: Axes, seen: CheckedTrial, t: np.ndarray, tip: np.ndarray) -> None:
    """Draw arm and string at a few times, the first darkest, and the tip's path."""
    path = tip * MM_PER_M
    axes.plot(*path.T, color="measured", lw=0.8, alpha=0.5, label="path of the tip")
    begin = max(t[0], seen.hand_t[0])
    end = min(t[-1], seen.hand_t[-1])
    for number, moment in enumerate(np.linspace(begin, max(end, begin), POSE_COUNT)):
        nearest = np.argmin(np.abs(seen.frame_t - moment))
        is_in_frame = seen.points["t"] == seen.frame_t[nearest]
        arm = _arm_at(seen, moment)
        string = np.vstack([arm[-1], seen.points.loc[is_in_frame, ["x", "y"]]])
        alpha = LATER_POSE_OPACITY if number else 1.0
        for name, points in (("arm", arm), ("string, as measured", string)):
            label = None if number else name
            x, y = (points * MM_PER_M).T
            axes.plot(x, y, alpha=alpha, label=label, **POSE_STYLES[name])
    axes.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal", adjustable="datalim")
    _add_legend(axes, 3)


def _arm_at(seen: CheckedTrial, t: float) -> np.ndarray:
    """Return the joint positions [m], or the hand's if only the hand was measured."""
    if seen.joints is None or seen.arm is None:
        return seen.hand_at(t)[None]
    return seen.arm.joint_positions(interpolate_rows(t, seen.hand_t, seen.joints))


def _draw_positions(
    axes: Axes, seen: CheckedTrial, t: np.ndarray, tip: np.ndarray
) -> None:
    hand = ("hand", "axis", seen.hand_t, seen.pose)
    for name, colour, times, positions in (hand, ("tip", "measured", t, tip)):
        x, y = positions[:, 0] * MM_PER_M, positions[:, 1] * MM_PER_M
        axes.plot(times, x, color=colour, label=f"{name} x")
        axes.plot(times, y, "--", color=colour, label=f"{name} y")
    axes.set_ylabel("position [mm]")
    _add_legend(axes, 4)


def _draw_speeds(
    axes: Axes, seen: CheckedTrial, t: np.ndarray, tip: np.ndarray
) -> None:
    """Draw speeds as shares of their maximum; with equal clocks both rise together."""
    hand = seen.pose[:, :2]
    _draw_speed(axes, seen.hand_t, hand, "hand, arm's clock", "axis")
    _draw_onset(axes, seen.hand_onset, "hand begins to move", "axis")
    _draw_speed(axes, t, tip, "tip, camera's clock", "measured")
    _draw_onset(axes, seen.string_onset, "string begins to move", "measured")
    axes.set(xlabel="time [s]", ylabel="speed [of fastest]")
    _add_legend(axes, 2)


def _draw_speed(
    axes: Axes, times: np.ndarray, positions: np.ndarray, label: str, colour: str
) -> None:
    """Draw the speed between positions (K, 2) [m] as a share of its maximum."""
    speed = step_lengths(positions) / np.maximum(np.diff(times), 1e-9)
    fastest = float(np.quantile(speed, 0.99)) if len(speed) else 0.0
    if fastest > 0:
        middle = (times[1:] + times[:-1]) / 2
        share = np.minimum(speed / fastest, 1.2)
        words = f"{label}: {fastest:.1f} m/s"
        axes.plot(middle, share, color=colour, lw=1, label=words)


def _draw_onset(axes: Axes, onset: float | None, label: str, colour: str) -> None:
    """Draw the onset of a motion, if there is one."""
    if onset is not None:
        axes.axvline(onset, color=colour, ls=":", lw=1, label=label)


def _add_legend(axes: Axes, columns: int) -> None:
    """Add a legend above the axes."""
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns)
