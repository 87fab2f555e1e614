"""From the log of a movement to the tables of a trial, and whether its timing can be
trusted.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from stringcast.data.artifacts import JOINTS, SENT_SPEEDS, SPEEDS
from stringcast.hardware.arm.loop import MovementLog
from stringcast.stages.execute.interfaces import Performance

# share of the exchanges, the quickest, that fix the device's clock
QUICK_FRACTION = 0.25


def build_performance(
    log: MovementLog, start: float, late: float, most_missed: float, trips: np.ndarray
) -> Performance:
    """Tables of a performance.

    start: time of the first tick in the movement's time [s]. late: lateness [s] above
    which a tick counts as missed; most_missed: share of missed ticks above which the
    trial is invalid. trips: round trips of the link test, (N,) [s].
    """
    lateness = log.sent - log.due
    missed = ~(lateness <= late) | np.isnan(log.acknowledged)
    share = missed.mean()
    reason = (
        f"{share:.1%} of the ticks were late or lost, allowed are {most_missed:.1%}"
        if share > most_missed
        else ""
    )
    link = {
        "valid": not reason,
        "reason": reason,
        "ticks": len(log.due),
        "missed": int(missed.sum()),
    }
    for name, spent in (("jitter", lateness), ("trip", trips)):
        p50, p99 = np.percentile(spent, [50, 99])
        link |= {f"{name}_p50": p50, f"{name}_p99": p99, f"{name}_max": spent.max()}
    # commanded, sent, acknowledged and measured, tick by tick
    times = {
        "t_due": log.due + start,
        "t_sent": log.sent + start,
        "t_acknowledged": log.acknowledged + start,
    }
    ticks = {"tick": np.arange(len(log.due)), **times, "t_device": log.device_time}
    for names, values in (
        (SPEEDS, log.commanded),
        (SENT_SPEEDS, log.speeds_sent),
        (JOINTS, log.angles),
    ):
        ticks |= dict(zip(names, values.T, strict=True))
    # joint angles at the device's own times, brought to the host's clock: the way to
    # the device and back may take long, but it cannot take less than nothing, so the
    # quickest exchanges tell the two clocks apart best
    known = np.flatnonzero(~np.isnan(log.acknowledged))
    sent, back, clock = log.sent[known], log.acknowledged[known], log.device_time[known]
    quick = (
        back - sent <= np.quantile(back - sent, QUICK_FRACTION)
        if len(known)
        else slice(None)
    )
    ahead = np.median((clock - (sent + back) / 2)[quick]) if len(known) else 0.0
    angles = dict(zip(JOINTS, log.angles[known].T, strict=True))
    measured = pd.DataFrame({"t": clock - ahead + start} | angles)
    measured = measured.sort_values("t").drop_duplicates("t").reset_index(drop=True)
    return Performance(
        measured,
        pd.DataFrame(ticks | {"missed": missed}),
        pd.DataFrame([link]),
        log.start,
    )
