"""A picture of a measured trial, on which a wrong unit, axis or clock is seen at a
glance.
"""

from __future__ import annotations

import numpy as np
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stringcast.stages.check.measured import CheckedTrial
from stringcast.stages.report.theme import LIGHT_COLOURS, MM_PER_M, STYLE_SHEET

# of arm and string that are drawn, evenly over the time in which both were seen
POSES = 5
FAINT = 0.25  # of those but the first


def trial_figure(seen: CheckedTrial) -> Figure:
    """Arm and string in the plane; hand and tip over time; and how fast both move, each
    on its own clock.
    """
    with style.context(STYLE_SHEET):
        figure = Figure(figsize=(11.0, 4.6))
        plane, places, speeds = figure.subplot_mosaic(
            [["plane", "places"], ["plane", "speeds"]]
        ).values()
        _in_the_plane(plane, seen)
        _over_time(places, speeds, seen)
        speeds.sharex(places)
    return figure


def trial_figures(seen: CheckedTrial) -> tuple[Figure, Figure]:
    """The same as two figures: the plane; and hand and tip over time, with how fast
    both move.
    """
    plane, times = Figure(figsize=(5.3, 4.6)), Figure(figsize=(5.3, 4.6))
    _in_the_plane(plane.subplots(), seen)
    places, speeds = times.subplots(2, sharex=True)
    _over_time(places, speeds, seen)
    return plane, times


def trial_words(seen: CheckedTrial) -> str:
    """A sentence on a trial: its frames, the string's length [mm], and when hand and
    string began to move.
    """
    begins = [
        f"{who} at {onset:.2f} s"
        for who, onset in (
            ("the hand", seen.hand_onset),
            ("the string", seen.string_onset),
        )
        if onset is not None
    ]
    moved = f"; {' and '.join(begins)} began to move" if begins else ""
    return f"Trial {seen.name}: {len(seen.frame_t)} frames of a string of {seen.length * MM_PER_M:.0f} mm{moved}."


def tip_of(seen: CheckedTrial) -> tuple[np.ndarray, np.ndarray]:
    """Times (F,) [s] and places (F, 2) [m] of the point that is furthest along the
    string.
    """
    end = seen.points.groupby("t").tail(1)
    return end["t"].to_numpy(), end[["x", "y"]].to_numpy()


def _in_the_plane(axes: Axes, seen: CheckedTrial) -> None:
    """Arm and string at a few times, the first darkest, and the tip's way."""
    t, tip = tip_of(seen)
    axes.plot(
        *(tip * MM_PER_M).T,
        color=LIGHT_COLOURS["measured"],
        lw=0.8,
        alpha=0.5,
        label="the tip's way",
    )
    low, high = max(t[0], seen.hand_t[0]), min(t[-1], seen.hand_t[-1])
    for number, at in enumerate(np.linspace(low, max(high, low), POSES)):
        strength, labels = (
            (FAINT, (None, None)) if number else (1.0, ("arm", "string, as measured"))
        )
        now = seen.points[
            seen.points["t"] == seen.frame_t[np.argmin(np.abs(seen.frame_t - at))]
        ]
        if seen.joints is None:  # the hand's pose alone was measured
            hand = np.array(
                [[np.interp(at, seen.hand_t, seen.pose[:, axis]) for axis in (0, 1)]]
            )
        else:
            hand = seen.arm.joint_positions(
                np.array([np.interp(at, seen.hand_t, angle) for angle in seen.joints.T])
            )
        line = np.vstack([hand[-1], now[["x", "y"]].to_numpy()]) * MM_PER_M
        axes.plot(
            *(hand * MM_PER_M).T,
            "o-",
            color=LIGHT_COLOURS["axis"],
            ms=3,
            lw=2.4,
            alpha=strength,
            label=labels[0],
        )
        axes.plot(
            *line.T,
            ".-",
            color=LIGHT_COLOURS["after"],
            ms=4,
            lw=1.2,
            alpha=strength,
            label=labels[1],
        )
    axes.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal", adjustable="datalim")
    _legend(axes, 3)


def _legend(axes: Axes, columns: int) -> None:
    """A legend above the axes, where it hides nothing."""
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns)


def _over_time(places: Axes, speeds: Axes, seen: CheckedTrial) -> None:
    """Where hand and tip are, and how fast, each as a share of its fastest: on one
    clock they begin together.
    """
    t, tip = tip_of(seen)
    for axis, dashes in (("x", "-"), ("y", "--")):
        number = "xy".index(axis)
        places.plot(
            seen.hand_t,
            seen.pose[:, number] * MM_PER_M,
            dashes,
            color=LIGHT_COLOURS["axis"],
            label=f"hand {axis}",
        )
        places.plot(
            t,
            tip[:, number] * MM_PER_M,
            dashes,
            color=LIGHT_COLOURS["measured"],
            label=f"tip {axis}",
        )
    places.set_ylabel("place [mm]")
    _legend(places, 4)

    for when, where, colour, who in (
        (seen.hand_t, seen.pose[:, :2], "axis", "hand, arm's clock"),
        (t, tip, "measured", "tip, camera's clock"),
    ):
        speed = np.linalg.norm(np.diff(where, axis=0), axis=1) / np.maximum(
            np.diff(when), 1e-9
        )
        fastest = float(np.quantile(speed, 0.99)) if len(speed) else 0.0
        if fastest > 0:
            shown = np.minimum(speed / fastest, 1.2)
            speeds.plot(
                (when[1:] + when[:-1]) / 2,
                shown,
                color=LIGHT_COLOURS[colour],
                lw=1,
                label=f"{who}: {fastest:.1f} m/s",
            )
    for onset, colour in ((seen.hand_onset, "axis"), (seen.string_onset, "measured")):
        if onset is not None:
            speeds.axvline(onset, color=LIGHT_COLOURS[colour], ls=":", lw=1)
    speeds.set(xlabel="time [s]", ylabel="speed [of fastest]")
    _legend(speeds, 2)
