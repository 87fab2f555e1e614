"""Offsets of two clocks that are possible for any string.

Hand and string begin to move at about the same time, and a string never gets longer.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from stringcast.data.schema import DataError
from stringcast.stages.check.measured import CheckedTrial

# Largest apparent lead and lag of the string's onset relative to the hand's. Onsets are
# detected after motion by 3 % of the string's length. A slack string lags, and so does
# one that a slow hand moves.
MAX_LEAD_S, MAX_LAG_S = 0.15, 0.5
MAX_SPREAD_S = 0.2  # median deviation of onsets between trials
STEP_S = 2e-3
# Tolerance of the stretch above that at the best offset: in noise sigmas, and relative
# to the string's length
STRETCH_SIGMAS, STRETCH_TOLERANCE = 3.0, 0.02
TRIMMED_SHARE = 0.03  # of the points: the farthest may be outliers
MAX_POINTS = 400  # per trial
HARMLESS_OFFSET_S = 0.03  # a diagnosis finds a smaller offset as `time_offset`


class Window(NamedTuple):
    """Offsets that are possible, added to the camera's times [s]."""

    low: float
    high: float

    @property
    def middle(self) -> float:
        """Middle of the window [s]."""
        return 0.5 * (self.low + self.high)

    @property
    def half_width(self) -> float:
        """Half the width of the window [s]."""
        return 0.5 * (self.high - self.low)


def onset_window(trial: CheckedTrial) -> Window | None:
    """Return the offsets at which hand and string begin to move together.

    Returns None for a trial that does not begin at rest, or in which nothing moves.
    """
    hand, string = trial.hand_onset, trial.string_onset
    if hand is None or string is None or trial.starts_moving:
        return None
    return Window(hand - string - MAX_LEAD_S, hand - string + MAX_LAG_S)


def overlap_window(trial: CheckedTrial) -> Window:
    """Return the offsets at which the hand's motion is known for half of the frames."""
    half = 0.5 * float(np.ptp(trial.frame_t))
    low = trial.hand_t[0] - trial.frame_t[0] - half
    high = trial.hand_t[-1] - trial.frame_t[-1] + half
    return Window(float(low), float(max(high, low)))


def stretch_by_offset(trial: CheckedTrial, offsets: np.ndarray) -> np.ndarray:
    """Return the stretch of the string at offsets (U,) [m].

    It is the rms excess of the points' distances from the hand over their arc lengths,
    (U,), without the farthest points.
    """
    every = max(len(trial.points) // MAX_POINTS, 1)
    points = trial.points.iloc[::every]
    s, x, y = points[["s", "x", "y"]].to_numpy().T
    t = points["t"].to_numpy() + offsets[:, None]
    hand_x, hand_y = np.moveaxis(trial.hand_at(t), -1, 0)
    distance = np.hypot(x - hand_x, y - hand_y)
    excess = np.sort(np.maximum(distance - s, 0.0), axis=1)
    kept_count = max(int((1 - TRIMMED_SHARE) * len(s)), 1)
    mean_square = np.mean(excess[:, :kept_count] ** 2, axis=1)
    return np.asarray(np.sqrt(mean_square))


def possible_windows(trials: Sequence[CheckedTrial]) -> dict[str, Window]:
    """Return the possible offsets of each trial.

    They are the same for all trials if one window suits all.

    Raises DataError if nothing moves.
    """
    windows = {}
    for trial in trials:
        window = onset_window(trial)
        if window is None and trial.starts_moving:
            window = overlap_window(trial)
        if window is not None:
            windows[trial.name] = window
    if not windows:
        raise DataError(
            f"trial {trials[0].name}",
            "hand or string never begins to move",
            "Give the seconds to add: --clock=-0.35",
        )

    used = [trial for trial in trials if trial.name in windows]
    common = common_window(list(windows.values()))
    if common is not None:
        return dict.fromkeys(windows, narrow_by_stretch(used, common))
    return {t.name: narrow_by_stretch([t], windows[t.name]) for t in used}


def largest_possible_offset(trials: Sequence[CheckedTrial]) -> float:
    """Return the largest possible offset of trials at rest, in either direction [s].

    It is 0 if none begins at rest.
    """
    resting = [trial for trial in trials if onset_window(trial) is not None]
    if not resting:
        return 0.0
    windows = possible_windows(resting).values()
    return max(max(-window.low, window.high) for window in windows)


def common_window(windows: Sequence[Window]) -> Window | None:
    """Return the median window of trials; None if they do not agree.

    The median is robust against strings that something else moved early.
    """
    low, high = np.median(windows, axis=0)
    middles = np.array([window.middle for window in windows])
    if np.median(np.abs(middles - np.median(middles))) > MAX_SPREAD_S:
        return None
    return Window(float(low), float(high))


def narrow_by_stretch(trials: Sequence[CheckedTrial], window: Window) -> Window:
    """Return the part of a window in which no string gets longer."""
    offsets = np.arange(window.low, window.high + STEP_S, STEP_S)
    is_possible = np.ones(len(offsets), dtype=bool)
    for trial in trials:
        stretch = stretch_by_offset(trial, offsets)
        noise = 0.0 if np.isnan(trial.noise) else trial.noise
        tolerance = max(STRETCH_SIGMAS * noise, STRETCH_TOLERANCE * trial.length)
        is_possible &= stretch < stretch.min() + tolerance
    if not is_possible.any():
        return window
    kept = offsets[is_possible]
    return Window(float(kept[0] - STEP_S), float(kept[-1] + STEP_S))
