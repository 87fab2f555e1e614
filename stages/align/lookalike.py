"""Offset or lag? An arm that lags a little looks like a clock that is off; how far, the
likelihood says.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from stringcast.data.alignment import LIKELIHOOD
from stringcast.stages.align.fit import AlignmentFit, AlignmentProblem, fit_alignment

OFFSET, LAG = "time_offset.offset", "arm_lag.time_constant"
# [s]
CANDIDATE_LAGS_S = (
    np.array([0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0]) * 1e-3
)
CHI_SQUARE_95 = 3.84  # rise of the deviance at the end of a 95 % interval
CLEAR_DEVIANCE = 10 * CHI_SQUARE_95  # rise beyond which nothing more is asked
PROFILE_OFFSETS = np.linspace(-4, 4, 17)  # standard deviations


def likelihood_profile(problem: AlignmentProblem, fit: AlignmentFit) -> pd.DataFrame:
    """Table LIKELIHOOD about the fit that was chosen."""
    rows = (
        _profile_with_lag(problem, fit)
        if "arm_lag" in fit.effects
        else _profile_without_lag(problem, fit)
    )
    columns = ["offset", "alone", "with_lag", "lag"]
    return LIKELIHOOD.check(pd.DataFrame(rows, columns=columns).sort_values("offset"))


def largest_hidden_lag(table: pd.DataFrame, fit: AlignmentFit) -> float:
    """Up to which lag [s] nothing shows whether there is one; 0 where one was measured."""
    if "arm_lag" in fit.effects:
        return 0.0
    rising = table[table["lag"] > 0]
    rise, lag = (np.concatenate([[0.0], rising[name]]) for name in ("with_lag", "lag"))
    return float(np.interp(CHI_SQUARE_95, np.maximum.accumulate(rise), lag))


def _profile_without_lag(
    problem: AlignmentProblem, fit: AlignmentFit
) -> list[tuple[float, ...]]:
    """No lag was seen: how large it could be with the offset growing along."""
    place = fit.names.index(OFFSET)
    offset, sigma = fit.x[place], np.sqrt(fit.covariance[place, place])
    rows: list[tuple[float, ...]] = [
        (offset + k * sigma, k**2, k**2, 0.0) for k in PROFILE_OFFSETS
    ]
    values = dict(fit.values)
    for lag in CANDIDATE_LAGS_S:
        held = {OFFSET: offset + lag}
        best = fit_alignment(
            problem, (*fit.effects, "arm_lag"), values | {LAG: lag}, held, fit.limit
        )
        values = best.values
        rise = max((best.deviance - fit.deviance) / fit.inflation, 0.0)
        rows.append((offset + lag, (lag / sigma) ** 2, rise, values[LAG]))
        if rise > CLEAR_DEVIANCE:
            break
    return rows


def _profile_with_lag(
    problem: AlignmentProblem, fit: AlignmentFit
) -> list[tuple[float, ...]]:
    """A lag was seen: how much worse an offset alone does."""
    alone = fit_alignment(
        problem,
        tuple(e for e in fit.effects if e != "arm_lag"),
        fit.values,
        limit=fit.limit,
    )
    place, lag = fit.names.index(OFFSET), fit.names.index(LAG)
    variance = fit.covariance[place, place]
    own = alone.names.index(OFFSET)
    more = (alone.deviance - fit.deviance) / fit.inflation
    rows: list[tuple[float, ...]] = []
    for k in PROFILE_OFFSETS:
        offset = fit.x[place] + k * np.sqrt(variance)
        off = (offset - alone.x[own]) ** 2 / alone.covariance[own, own]
        follows = fit.x[lag] + fit.covariance[lag, place] / variance * (
            offset - fit.x[place]
        )
        rows.append((offset, more + off, k**2, follows))
    return rows
