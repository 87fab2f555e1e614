"""Exposure times and losses of the frames of a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pandas as pd

from stringcast.data.artifacts import lateness_columns
from stringcast.hardware.camera.schedule import FrameSchedule, fit_schedule
from stringcast.hardware.camera.source import Frame
from stringcast.stages.execute.interfaces import Recording

# fraction of equal neighbours at rest above which images have no noise (rendered or
# compressed), so that equality does not mean repetition
NOISELESS_FRACTION = 0.75
LATE_PERIODS = 0.5  # lateness above which a frame counts as late


@dataclass(frozen=True)
class RawFilm:
    """The frames of a film before they are timed.

    Attributes
    ----------
    frames
        Grey frames in the order of arrival.
    until
        Earliest regular end of filming, in the movement's time [s].
    failure
        Why filming ended earlier; empty if it did not.
    remarks
        Unverified properties.
    """

    frames: Sequence[Frame]
    until: float
    failure: str
    remarks: tuple[str, ...]


def build_recording(
    film: RawFilm, moved_at: float, delay: float, period: float, most_lost: float
) -> Recording:
    """Time the frames of a film and count the lost ones.

    Parameters
    ----------
    film
        The frames.
    moved_at
        Host time of the movement's start [s].
    delay
        Time from mid-exposure to the quickest arrival [s].
    period
        Nominal period of the frames [s].
    most_lost
        Fraction of dropped or repeated frames above which the film is invalid.

    Returns
    -------
    Recording
        The frames in the movement's time.
    """
    arrival_times = np.array([frame.arrival_time for frame in film.frames])
    arrivals = arrival_times - moved_at - delay
    stamps = np.array([frame.stamp for frame in film.frames])
    images = [frame.image for frame in film.frames]

    # repeated frames were not exposed
    resting = int((arrivals < 0).sum())
    is_repeated = repeated_frames(images, resting)
    repeated_count = int(is_repeated.sum())
    new = np.flatnonzero(~is_repeated)
    t, schedule = exposure_times(arrivals[new], stamps[new], period)
    counts = {
        "number": schedule.numbers,
        "late": schedule.lateness,
        "repeats": np.diff(np.append(new, len(is_repeated))) - 1,
    }

    # a repeated frame means a missing exposure
    due = max(schedule.last_due_number(film.until), int(schedule.numbers[-1])) + 1
    dropped = due - len(schedule.numbers)
    is_late = schedule.lateness > LATE_PERIODS * schedule.period
    summary = {
        "frames_due": due,
        "frames_dropped": dropped,
        "frames_repeated": repeated_count,
        "frames_late": int(is_late.sum()),
        "fps": 1 / schedule.period,
        "remarks": "; ".join(film.remarks),
    }
    summary |= lateness_columns("frame_jitter", schedule.lateness)

    fault = ""
    if film.failure and t[-1] < film.until - 2 * period:
        fault = f"the camera saw nothing after {t[-1]:.3f} s: {film.failure}"
    elif dropped / due > most_lost:
        repeats = f" ({repeated_count} came twice instead)" if repeated_count else ""
        fault = (
            f"{dropped / due:.1%} of the frames were dropped{repeats}, "
            f"allowed are {most_lost:.1%}"
        )
    frames = [images[index] for index in new]
    return Recording(t, frames, pd.DataFrame(counts), summary, fault)


def repeated_frames(images: Sequence[np.ndarray], resting: int) -> np.ndarray:
    """Find images that equal the previous one bit by bit.

    Sensor noise excludes equal images. If nearly all images before the movement are
    equal, there is no noise, and none counts as repeated.

    Parameters
    ----------
    images
        F images.
    resting
        Number of images before the movement.

    Returns
    -------
    (F,) bool
        True for a repetition.
    """
    is_repeated = np.zeros(len(images), dtype=bool)
    for index, (previous, image) in enumerate(pairwise(images), 1):
        is_repeated[index] = np.array_equal(previous, image)
    at_rest = is_repeated[1:resting]
    if at_rest.size > 0 and at_rest.mean() > NOISELESS_FRACTION:
        return np.zeros_like(is_repeated)
    return is_repeated


def exposure_times(
    arrivals: np.ndarray, stamps: np.ndarray, period: float
) -> tuple[np.ndarray, FrameSchedule]:
    """Estimate the exposure times of frames.

    Stamps of the source are exposure times up to a constant, given by the quickest
    arrival. Without stamps, exposure times follow a steady schedule, as only arrivals
    have random delays.

    Parameters
    ----------
    arrivals : (F,)
        Times of arrival, less the delay [s].
    stamps : (F,)
        The source's own times; NaN if it has none [s].
    period
        Nominal period of the frames [s].

    Returns
    -------
    times : (F,)
        Times of exposure [s].
    schedule : FrameSchedule
        The schedule of these times.
    """
    count = len(arrivals)
    if count < 3:
        numbers = np.arange(count)
        return arrivals, FrameSchedule(period, numbers, arrivals, np.zeros(count))
    if _are_clock_times(stamps, arrivals, period):
        t = stamps + (arrivals - stamps).min()
        return t, replace(fit_schedule(t, period), lateness=arrivals - t)
    schedule = fit_schedule(arrivals, period)
    return schedule.due, schedule


def _are_clock_times(stamps: np.ndarray, arrivals: np.ndarray, period: float) -> bool:
    """Return whether stamps (F,) come from a clock [s].

    Other stamps are frame numbers times the nominal period, or NaN.
    """
    if not (np.isfinite(stamps).all() and (np.diff(stamps) > 0).all()):
        return False
    difference = arrivals - stamps
    half = len(stamps) // 2
    drift = np.median(difference[:half]) - np.median(difference[half:])
    return bool(abs(drift) < period)
