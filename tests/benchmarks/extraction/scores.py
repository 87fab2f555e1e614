"""Errors of what was read: a row for each frame, and shares by condition.

A frame is wrong when it was accepted and its line, a place on it or its tip is off by
more than WRONG_PX, or its line or tip by more than WRONG_SIGMAS of the stated
uncertainty. A wrong frame does harm; a refused one only costs data.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.stats import binomtest

from stringcast.data.artifacts import Points
from stringcast.data.schema import Table, parse_columns
from stringcast.stages.common import rms
from tests.benchmarks.extraction.conditions import Shot
from tests.benchmarks.extraction.films import ConditionLevel, StagedCast

WRONG_PX = 3.0  # [px]
WRONG_SIGMAS = 5.0  # in stated standard deviations
FRAMES = Table(
    "frames",
    "a row a frame: what was read and how far off it is; NaN where nothing was",
    parse_columns("""
    condition (text): under which it was filmed
    severity [1] (int): of the condition, from 1
    string (text): which was cast
    cast [1] (int): seed of the cast
    frame [1] (int): number of the frame
    read (bool): the frame was accepted
    reason (text): why it was not
    line_px [px]: RMS distance of the points from the true curve
    line_mm [mm]: the same
    place_px [px]: RMS distance of the points from where they are on the true string
    tip_px [px]: distance of the tips
    line_stated_px [px]: RMS sigma stated for the points
    tip_stated_px [px]: sigma stated for the tip
    line_sigmas [1]: RMS over the points of distance over sigma stated
    tip_sigmas [1]: distance of the tips over sigma stated
    wrong (bool): accepted, and off by more than the limits
    """),
)
SHARES = Table(
    "shares",
    "a row a condition and severity: all strings and casts together",
    parse_columns("""
    condition (text): under which it was filmed
    severity [1] (int): of the condition, from 1
    frames [1] (int): how many
    read [1]: share that was accepted
    wrong [1]: share of all that was accepted and is wrong
    wrong_high [1]: upper end of its 95 % interval (Clopper and Pearson)
    line_px [px]: median of what was accepted
    line_mm [mm]: the same
    line_px_95 [px]: 95 % of what was accepted is below
    tip_px [px]: median of what was accepted
    tip_px_95 [px]: 95 % of what was accepted is below
    line_sigmas [1]: RMS of what was accepted, across alone; sigma is of a coordinate,
        along too
    tip_sigmas [1]: the same; 1.4 if u and v are each off by a sigma
    reasons (text): of refusals, the most frequent first
    """),
)


def compare_frames(
    cast: StagedCast, level: ConditionLevel, points: Points, shot: Shot
) -> pd.DataFrame:
    """Return table FRAMES of one film."""
    truth = dict(zip(np.round(shot.frame_times, 6), shot.truth, strict=True))
    errors = {}
    for t, rows in points.points.groupby("t"):
        moment = round(float(t), 6)
        errors[moment] = _frame_errors(rows, truth[moment], shot.camera.px_per_m)
    readings = points.readings
    of_frames = [errors.get(round(float(t), 6), {}) for t in readings["t"]]
    frame = readings[["frame", "reason"]].assign(
        condition=level.condition,
        severity=level.severity,
        string=cast.string,
        cast=cast.seed,
        read=readings["valid"],
    )
    frame = frame.join(pd.DataFrame(of_frames, columns=list(_ERROR_COLUMNS)))
    far = (frame[["line_px", "place_px", "tip_px"]] > WRONG_PX).any(axis=1)
    overconfident = (frame[["line_sigmas", "tip_sigmas"]] > WRONG_SIGMAS).any(axis=1)
    return FRAMES.check(frame.assign(wrong=frame["read"] & (far | overconfident)))


_ERROR_COLUMNS = tuple(c.name for c in FRAMES.columns if "_" in c.name)


def _frame_errors(
    rows: pd.DataFrame, true: np.ndarray, px_per_m: float
) -> dict[str, float]:
    """Return distances of the points of one frame from the true string (n, 2) [m]."""
    points, sigma = rows[["x", "y"]].to_numpy(), rows["sigma"].to_numpy() * px_per_m
    share = rows["s"].to_numpy() / rows["s"].iloc[-1]
    lengths = np.linalg.norm(np.diff(true, axis=0), axis=-1)
    true_share = np.concatenate([[0.0], lengths.cumsum()])
    true_share = true_share / true_share[-1]
    curve = _interpolate(np.linspace(0, 1, 801), true_share, true)
    places = _interpolate(share, true_share, true)
    line = np.linalg.norm(points[:, None] - curve[None], axis=-1).min(axis=1) * px_per_m
    place = np.linalg.norm(points - places, axis=-1) * px_per_m
    return {
        "line_px": rms(line),
        "line_mm": rms(line) / px_per_m * 1e3,
        "place_px": rms(place),
        "tip_px": place[-1],
        "line_stated_px": rms(sigma),
        "tip_stated_px": sigma[-1],
        "line_sigmas": rms(line / sigma),
        "tip_sigmas": place[-1] / sigma[-1],
    }


def _interpolate(at: np.ndarray, share: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Interpolate points (n, 2) at shares of the length, (K, 2)."""
    return np.stack([np.interp(at, share, points[:, i]) for i in (0, 1)], axis=-1)


def count_shares(frames: pd.DataFrame) -> pd.DataFrame:
    """Return table SHARES of table FRAMES."""
    rows = []
    for (condition, severity), some in frames.groupby(
        ["condition", "severity"], sort=False
    ):
        good, wrong = some[some["read"]], int(some["wrong"].sum())
        row = {
            "condition": condition,
            "severity": severity,
            "frames": len(some),
            "read": some["read"].mean(),
        }
        most = binomtest(wrong, len(some)).proportion_ci(0.95, method="exact").high
        row |= {
            "wrong": wrong / len(some),
            "wrong_high": most,
            "reasons": refusal_reasons(some),
        }
        row |= {name: good[name].median() for name in ("line_px", "line_mm", "tip_px")}
        row |= {
            f"{name}_95": good[name].quantile(0.95) for name in ("line_px", "tip_px")
        }
        row |= {
            name: np.sqrt((good[name] ** 2).mean())
            for name in ("line_sigmas", "tip_sigmas")
        }
        rows.append(row)
    return SHARES.check(pd.DataFrame(rows))


def refusal_reasons(frames: pd.DataFrame) -> str:
    """Count the reasons of refusals.

    `frames` has a column `reason`, which is empty if the frame was read.
    """
    counts = frames.loc[frames["reason"] != "", "reason"].value_counts()
    return "; ".join(f"{reason} ({count})" for reason, count in counts.items())
