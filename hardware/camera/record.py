"""From what was taken to a recording: when each frame was exposed, what was lost, and
whether it can be trusted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pandas as pd

from stringcast.hardware.camera.schedule import FrameSchedule, fit_schedule
from stringcast.hardware.camera.source import Frame
from stringcast.stages.execute.interfaces import Recording

# share of equal neighbours at rest from which images are drawn or compressed: then
# equality says nothing
NOISELESS_FRACTION = 0.75
LATE_PERIODS = 0.5  # periods after its moment at which a frame counts as late


@dataclass(frozen=True)
class RawFilm:
    """frames: grey, in the order of arrival. until: when filming could end, in the
    movement's time [s]. died: why it ended before; empty if it did not. remarks: what
    could not be made sure of.
    """

    frames: Sequence[Frame]
    until: float
    failure: str
    remarks: tuple[str, ...]


def build_recording(
    film: RawFilm, moved_at: float, delay: float, period: float, most_lost: float
) -> Recording:
    """A film in the movement's time.

    moved_at: host time of the movement's start [s]. delay: from mid-exposure to the
    quickest arrival [s]. period: of the frames, about [s]. most_lost: share dropped or
    repeated above which the film cannot be trusted.
    """
    arrived = np.array([frame.arrival_time for frame in film.frames]) - moved_at - delay
    images = [frame.image for frame in film.frames]
    again = repeated_frames(images, int((arrived < 0).sum()))
    own = np.flatnonzero(~again)
    stamps = np.array([frame.stamp for frame in film.frames])
    t, schedule = exposure_times(arrived[own], stamps[own], period)
    repeats = np.diff(np.append(own, len(again))) - 1
    counts = pd.DataFrame(
        {"number": schedule.numbers, "late": schedule.lateness, "repeats": repeats}
    )
    summary = _summarise(schedule, film, int(again.sum()))
    summary["remarks"] = "; ".join(film.remarks)
    # the film ended too early, or too many frames were lost; one that came twice left
    # its place on the schedule empty
    lost = int(summary["frames_dropped"]) / int(summary["frames_due"])
    fault = ""
    if film.failure and t[-1] < film.until - 2 * period:
        fault = f"the camera saw nothing after {t[-1]:.3f} s: {film.failure}"
    elif lost > most_lost:
        twice = f" ({again.sum()} came twice instead)" if again.any() else ""
        fault = (
            f"{lost:.1%} of the frames were dropped{twice}, allowed are {most_lost:.1%}"
        )
    return Recording(t, [images[i] for i in own], counts, summary, fault)


def repeated_frames(images: Sequence[np.ndarray], resting: int) -> np.ndarray:
    """(F,) bool: the image is the one before, to the bit, which no sensor's noise
    allows.

    resting: how many come before the movement. Where nearly all of those are equal
    there is no noise to judge by.
    """
    again = np.array([False, *(np.array_equal(a, b) for a, b in pairwise(images))])
    still = again[1:resting]
    drawn = still.size > 0 and still.mean() > NOISELESS_FRACTION
    return np.zeros_like(again) if drawn else again


def exposure_times(
    arrived: np.ndarray, stamps: np.ndarray, period: float
) -> tuple[np.ndarray, FrameSchedule]:
    """Times of exposure of the frames, (F,) [s], and the schedule behind them.

    arrived: (F,), taken back by the delay. A source's own stamps are times of exposure
    but for a constant, which the quickest arrival fixes. Arrivals are late by chance,
    exposures are not: without stamps they are on schedule.
    """
    if len(arrived) < 3:
        return arrived, FrameSchedule(
            period, np.arange(len(arrived)), arrived, np.zeros(len(arrived))
        )
    # stamps are a clock's, and not the number of the frame times a nominal period, or
    # nothing
    late = arrived - stamps
    counted = np.isfinite(stamps).all() and (np.diff(stamps) > 0).all()
    if (
        counted
        and abs(np.median(late[: len(late) // 2]) - np.median(late[len(late) // 2 :]))
        < period
    ):
        t = stamps + (arrived - stamps).min()
        return t, replace(fit_schedule(t, period), lateness=arrived - t)
    schedule = fit_schedule(arrived, period)
    return schedule.due, schedule


def _summarise(
    schedule: FrameSchedule, film: RawFilm, repeats: int
) -> dict[str, float | int | str]:
    """Optional columns of table LINK: frames due until filming could end, what became
    of them, and how late.
    """
    numbers, until = schedule.numbers, film.until
    due = max(schedule.last_due_number(until), int(numbers[-1])) + 1
    p50, p99, most = map(float, np.percentile(schedule.lateness, [50, 99, 100]))
    return {
        "frames_due": due,
        "frames_dropped": due - len(numbers),
        "frames_repeated": repeats,
        "frames_late": int((schedule.lateness > LATE_PERIODS * schedule.period).sum()),
        "fps": 1 / schedule.period,
        "frame_jitter_p50": p50,
        "frame_jitter_p99": p99,
        "frame_jitter_max": most,
    }
