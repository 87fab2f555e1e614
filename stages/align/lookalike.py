"""Likelihood profile of clock offset and arm lag, which look alike."""

from __future__ import annotations

import numpy as np
import pandas as pd

from stringcast.data.alignment import LIKELIHOOD
from stringcast.stages.align.fit import AlignmentFit, AlignmentProblem, fit_alignment

OFFSET, LAG = "time_offset.offset", "arm_lag.time_constant"
CANDIDATE_LAGS_S = (
    np.array([0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0]) * 1e-3
)
CHI_SQUARE_95 = 3.84  # rise of the deviance at the end of a 95 % interval
CLEAR_DEVIANCE = 10 * CHI_SQUARE_95  # rise from which no larger lag is tried
PROFILE_OFFSETS = np.linspace(-4, 4, 17)  # in standard deviations


def likelihood_profile(problem: AlignmentProblem, fit: AlignmentFit) -> pd.DataFrame:
    """Compute the deviance over the clock offset, with and without a lag.

    Returns table LIKELIHOOD of the selected fit.
    """
    if "arm_lag" in fit.effects:
        rows = _profile_with_lag(problem, fit)
    else:
        rows = _profile_without_lag(problem, fit)
    columns = ["offset", "alone", "with_lag", "lag"]
    return LIKELIHOOD.check(pd.DataFrame(rows, columns=columns).sort_values("offset"))


def largest_hidden_lag(profile: pd.DataFrame, fit: AlignmentFit) -> float:
    """Return the largest lag that would not be detected [s]; 0 if one was measured."""
    if "arm_lag" in fit.effects:
        return 0.0
    rising = profile[profile["lag"] > 0]
    rise = np.concatenate([[0.0], rising["with_lag"]])
    lag = np.concatenate([[0.0], rising["lag"]])
    return float(np.interp(CHI_SQUARE_95, np.maximum.accumulate(rise), lag))


def _profile_without_lag(
    problem: AlignmentProblem, fit: AlignmentFit
) -> list[tuple[float, ...]]:
    """Profile a fit without lag: rise of deviance if lag and offset grow together."""
    place = fit.names.index(OFFSET)
    offset, sigma = fit.x[place], np.sqrt(fit.covariance[place, place])
    rows: list[tuple[float, ...]] = [
        (offset + k * sigma, k**2, k**2, 0.0) for k in PROFILE_OFFSETS
    ]
    values = dict(fit.values)
    effects = (*fit.effects, "arm_lag")
    for lag in CANDIDATE_LAGS_S:
        fixed = {OFFSET: offset + lag}
        start = values | {LAG: lag}
        lagging = fit_alignment(problem, effects, start, fixed, fit.limit)
        values = lagging.values
        rise = max((lagging.deviance - fit.deviance) / fit.inflation, 0.0)
        rows.append((offset + lag, (lag / sigma) ** 2, rise, values[LAG]))
        if rise > CLEAR_DEVIANCE:
            break
    return rows


def _profile_with_lag(
    problem: AlignmentProblem, fit: AlignmentFit
) -> list[tuple[float, ...]]:
    """Profile a fit with lag: the rise of deviance with an offset alone."""
    effects = tuple(effect for effect in fit.effects if effect != "arm_lag")
    alone = fit_alignment(problem, effects, fit.values, limit=fit.limit)
    loss = (alone.deviance - fit.deviance) / fit.inflation
    place, lag_place = fit.names.index(OFFSET), fit.names.index(LAG)
    place_alone = alone.names.index(OFFSET)
    variance = fit.covariance[place, place]
    slope = fit.covariance[lag_place, place] / variance
    rows: list[tuple[float, ...]] = []
    for k in PROFILE_OFFSETS:
        offset = fit.x[place] + k * np.sqrt(variance)
        distance = offset - alone.x[place_alone]
        rise = distance**2 / alone.covariance[place_alone, place_alone]
        lag = fit.x[lag_place] + slope * (offset - fit.x[place])
        rows.append((offset, loss + rise, k**2, lag))
    return rows
