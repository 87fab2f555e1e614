"""From the log of a movement to the tables of a trial, and whether its timing can be trusted."""

from __future__ import annotations

import numpy as np
import pandas as pd

from stringcast.data.artifacts import JOINTS, SENT, SPEEDS
from stringcast.hardware.arm.loop import Log
from stringcast.stages.execute.interfaces import Performance

QUICK = 0.25  # share of the exchanges, the quickest, that fix the device's clock


def performance(log: Log, start: float, late: float, most_missed: float, trips: np.ndarray) -> Performance:
    """Tables of a performance.

    start: time of the first tick in the movement's time [s]. late: lateness [s] above which a tick counts as
    missed; most_missed: share of missed ticks above which the trial is invalid. trips: round trips of the link
    test, (N,) [s].
    """
    lateness = log.sent - log.due
    missed = ~(lateness <= late) | np.isnan(log.acknowledged)
    share = missed.mean()
    reason = f"{share:.1%} of the ticks were late or lost, allowed are {most_missed:.1%}" if share > most_missed else ""
    link = {"valid": not reason, "reason": reason, "ticks": len(log.due), "missed": int(missed.sum())}
    link |= _distribution("jitter", lateness) | _distribution("trip", trips)
    return Performance(_measured(log, start), _ticks(log, start, missed), pd.DataFrame([link]), log.begun)


def _distribution(name: str, values: np.ndarray) -> dict[str, float]:
    p50, p99 = np.percentile(values, [50, 99])
    return {f"{name}_p50": p50, f"{name}_p99": p99, f"{name}_max": values.max()}


def _ticks(log: Log, start: float, missed: np.ndarray) -> pd.DataFrame:
    """Table TICKS: commanded, sent, acknowledged and measured, tick by tick."""
    times = {"t_due": log.due + start, "t_sent": log.sent + start, "t_acknowledged": log.acknowledged + start}
    columns = {"tick": np.arange(len(log.due)), **times, "t_device": log.clock}
    for names, values in ((SPEEDS, log.asked), (SENT, log.carried), (JOINTS, log.angles)):
        columns |= dict(zip(names, values.T, strict=True))
    return pd.DataFrame(columns | {"missed": missed})


def _measured(log: Log, start: float) -> pd.DataFrame:
    """Joint angles at the device's own times, brought to the host's clock: the way to the device and back may
    take long, but it cannot take less than nothing, so the quickest exchanges tell the two clocks apart best."""
    known = np.flatnonzero(~np.isnan(log.acknowledged))
    sent, back, clock = log.sent[known], log.acknowledged[known], log.clock[known]
    quick = back - sent <= np.quantile(back - sent, QUICK) if len(known) else slice(None)
    ahead = np.median((clock - (sent + back) / 2)[quick]) if len(known) else 0.0
    angles = dict(zip(JOINTS, log.angles[known].T, strict=True))
    table = pd.DataFrame({"t": clock - ahead + start} | angles)
    return table.sort_values("t").drop_duplicates("t").reset_index(drop=True)
