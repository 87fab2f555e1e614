"""The tables of a trial, from the log of a movement, and its timing budget."""

from __future__ import annotations

import numpy as np
import pandas as pd

from stringcast.data.artifacts import JOINTS, SENT_SPEEDS, SPEEDS, lateness_columns
from stringcast.hardware.arm.loop import MovementLog
from stringcast.stages.execute.interfaces import Performance

# fraction of the exchanges, the quickest ones, used to align the device's clock
QUICK_FRACTION = 0.25


def build_performance(
    log: MovementLog, start: float, late: float, most_missed: float, trips: np.ndarray
) -> Performance:
    """Build the tables of a performance from its log.

    Parameters
    ----------
    log
        The log of the movement.
    start
        Time of the first tick in the movement's time [s].
    late
        Lateness above which a tick counts as missed [s].
    most_missed
        Fraction of missed ticks above which the trial is invalid.
    trips : (N,)
        Round trips of the link test [s].

    Returns
    -------
    Performance
        Tables ARM, TICKS and LINK.
    """
    lateness = log.sent - log.due
    missed = ~(lateness <= late) | np.isnan(log.acknowledged)
    missed_fraction = missed.mean()
    reason = ""
    if missed_fraction > most_missed:
        reason = (
            f"{missed_fraction:.1%} of the ticks were late or lost, "
            f"allowed are {most_missed:.1%}"
        )
    link = {
        "valid": not reason,
        "reason": reason,
        "ticks": len(log.due),
        "missed": int(missed.sum()),
    }
    is_sent = np.isfinite(lateness)
    lateness = lateness[is_sent] if is_sent.any() else lateness
    link |= lateness_columns("jitter", lateness) | lateness_columns("trip", trips)
    ticks = {
        "tick": np.arange(len(log.due)),
        "t_due": log.due + start,
        "t_sent": log.sent + start,
        "t_acknowledged": log.acknowledged + start,
        "t_device": log.device_time,
    }
    ticks |= dict(zip(SPEEDS, log.commanded.T, strict=True))
    ticks |= dict(zip(SENT_SPEEDS, log.speeds_sent.T, strict=True))
    ticks |= dict(zip(JOINTS, log.angles.T, strict=True))
    ticks["missed"] = missed
    return Performance(
        _measured_angles(log, start),
        pd.DataFrame(ticks),
        pd.DataFrame([link]),
        log.start,
    )


def _measured_angles(log: MovementLog, start: float) -> pd.DataFrame:
    """Convert joint angles at device times to the host's clock.

    The quickest exchanges align the clocks best, as their delays are smallest.
    """
    answered = np.flatnonzero(~np.isnan(log.sent + log.acknowledged))
    sent, acknowledged = log.sent[answered], log.acknowledged[answered]
    clock = log.device_time[answered]
    offset = 0.0
    if len(answered):
        trips = acknowledged - sent
        is_quick = trips <= np.quantile(trips, QUICK_FRACTION)
        offset = np.median((clock - (sent + acknowledged) / 2)[is_quick])
    columns = {"t": clock - offset + start}
    columns |= dict(zip(JOINTS, log.angles[answered].T, strict=True))
    measured = pd.DataFrame(columns).sort_values("t")
    return measured.drop_duplicates("t").reset_index(drop=True)
