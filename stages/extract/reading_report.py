"""Messages about unread frames, with remedies."""

from __future__ import annotations

import numpy as np
import pandas as pd

MIN_READ_SHARE = 0.5  # of the frames; below it the outcome of a cast is uncertain
MEASURE_ALIGNMENT = (
    "the reported joints may be wrong: measure them with +experiment=align"
)
REMEDIES = {
    "no string in view": "check light, contrast and camera.origin_px",
    "no string at the grasp": MEASURE_ALIGNMENT,
    "the grasp is out of view": "make sure that the camera shows the arm's whole reach",
    "the line is shorter than the string": "check string.length and camera.px_per_m",
    "the line is longer than the string": MEASURE_ALIGNMENT,
    "the string leaves the picture": "make sure that the camera shows the whole string",
    "the string is interrupted": "use more light or a shorter exposure",
    "the string lies on itself, or on something like it": "choose a gentler motion",
    "something like a string hangs together with the string": MEASURE_ALIGNMENT,
}


def describe_poor_reading(readings: pd.DataFrame) -> str:
    """Describe that few frames were read, with a remedy.

    Parameters
    ----------
    readings : table READINGS
        Of all frames of a film.

    Returns
    -------
    str
        Empty if at least half of the frames were read.
    """
    if not len(readings) or readings["valid"].mean() >= MIN_READ_SHARE:
        return ""
    sentence = (
        f"The string was read in only {count_frames_read(readings)}, so the tip may "
        "have come closer than was measured."
    )
    remedy = REMEDIES.get(commonest_reason(readings))
    return f"{sentence} Remedy: {remedy}." if remedy else sentence


def describe_arm_misfit(readings: pd.DataFrame) -> str:
    """Describe that the arm differs from its reported joints, with a remedy.

    Parameters
    ----------
    readings : table READINGS
        Of all frames of a film.

    Returns
    -------
    str
        Empty if the reported joints are right, or if the arm is not clearly visible.
    """
    if "hand_shift" not in readings or not len(readings):
        return ""
    shift_mm = 1e3 * readings["hand_shift"].max()
    error_deg = np.degrees(readings["joint_error"].max())
    return (
        f"The arm differs from its reported joints: the hand is up to {shift_mm:.0f} "
        f"mm off, as if a joint were off by {error_deg:.1f} degrees. The string was "
        "read from the arm in the picture. The gain of the joints, the camera or its "
        "clock may be the cause. Remedy: measure them with +experiment=align."
    )


def count_frames_read(readings: pd.DataFrame) -> str:
    """Describe how many frames were read, with the commonest reason for the others."""
    text = f"{int(readings['valid'].sum())} of {len(readings)} frames"
    reason = commonest_reason(readings)
    return f"{text} (most often: {reason})" if reason else text


def commonest_reason(readings: pd.DataFrame) -> str:
    """Return the commonest reason for an unread frame; empty if all were read."""
    reasons = readings.loc[~readings["valid"].astype(bool), "reason"]
    return str(reasons.mode().iloc[0]) if len(reasons) else ""
