"""From candidates and scores to the Estimate artifact, the same for every method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from stringcast.data.artifacts import (
    CANDIDATES,
    DRAWS,
    ESTIMATION_SUMMARY,
    MATCHING,
    PARAMETERS,
    Estimate,
)
from stringcast.data.schema import DataError
from stringcast.stages.estimate.matching import MatchingTarget, matching_rate
from stringcast.stages.model.parameter import Parameter, parameter_values

# candidates within this much of the best E are as good as it
EQUAL_RATE_TOLERANCE = 0.01
# an undetermined parameter's good values spread over this share of its range
UNDETERMINED_SPREAD = 0.5
SCAN_EXPONENTS = np.linspace(0, 1, 21)  # chi at which a parameter is tried for that
# correlation beyond which two parameters are known only together
MAX_CORRELATION = 0.95
# E below which the model does not explain the data, whatever its parameters
MIN_MATCHING_RATE = 0.6
MAX_RMS_SHARE = 0.1  # of the string's length: a residual beyond that is no fit either
BOUND_TOLERANCE = 0.01  # of the range: a value this close to an end sits on it


@dataclass(frozen=True)
class Candidates:
    """Candidates of a method, in order: chi (C, P) and matching rate E (C,), NaN where
    the simulation diverged.
    """

    method: str
    chi: np.ndarray
    matching_rate: np.ndarray

    def __post_init__(self) -> None:
        """Refuse a search without a single string in it."""
        if np.isnan(self.matching_rate).all():
            raise DataError(
                f"{self.method}: none of {len(self.chi)} candidates stayed finite. Narrow string.ranges, "
                "or look for jumps in the arm's joint angles."
            )

    @property
    def best_index(self) -> int:
        """The candidate with the highest E."""
        return int(np.nanargmax(self.matching_rate))


@dataclass(frozen=True)
class Interval:
    """95 % intervals in chi, low and high (P,); which parameters the data determines
    (P,) bool; the same as a sentence.
    """

    low: np.ndarray
    high: np.ndarray
    determined: np.ndarray
    sentence: str


def start_chi(parameters: Sequence[Parameter], previous: Estimate | None) -> np.ndarray:
    """The start of the search: the previous manipulation's estimate, else the start
    values, (P,).
    """
    known = {} if previous is None else previous.values()
    return np.array(
        [float(p.chi(np.asarray(known.get(p.name, p.start)))) for p in parameters]
    )


def build_estimate(
    goals: Sequence[MatchingTarget],
    before: np.ndarray,
    after: np.ndarray,
    search: Candidates,
    interval: Interval,
    draws: np.ndarray,
) -> Estimate:
    """The artifact of an estimation. before, after: (P,) exponents of Eq. 3. search:
    all candidates tried. draws: (K, P) that the trials leave possible.
    """
    parameters = goals[0].trial.model.parameters
    pair = parameter_values(parameters, np.stack([before, after]))
    scores = [(goal.trial, *goal.rates_by_frame(pair)[0]) for goal in goals]
    frames = [
        pd.DataFrame({"trial": c.name, "t": c.times, "before": old, "after": new})
        for c, old, new in scores
    ]
    matching = pd.concat(frames, ignore_index=True)
    rms, tip = np.sqrt(
        np.mean(
            [[goal.trial.mean_square_distances(v) for v in pair] for goal in goals],
            axis=0,
        )
    ).T
    rate = search.matching_rate
    fit = {
        "method": search.method,
        "before": matching["before"].mean(),
        "after": matching["after"].mean(),
        "rms_before": rms[0],
        "rms_after": rms[1],
        "tip_before": tip[0],
        "tip_after": tip[1],
        "rejected": int(np.isnan(rate).sum()),
        "sentence": describe_bad_fit(
            matching["after"].mean(), rms[1], goals[0].trial.model.string.length
        )
        or interval.sentence,
    }
    record = np.fmax.accumulate(np.where(np.isnan(rate), -np.inf, rate))
    better = np.concatenate([[True], record[1:] > record[:-1]]) & ~np.isnan(rate)
    tried = {
        "candidate": np.arange(len(rate)),
        "matching_rate": rate,
        "finite": ~np.isnan(rate),
        "accepted": better,
    }
    return Estimate(
        PARAMETERS.check(_parameter_table(parameters, pair[1], after, interval)),
        CANDIDATES.check(pd.DataFrame(tried | _value_columns(parameters, search.chi))),
        MATCHING.check(matching),
        ESTIMATION_SUMMARY.check(pd.DataFrame([fit])),
        DRAWS.check(
            pd.DataFrame(
                {"draw": np.arange(len(draws))} | _value_columns(parameters, draws)
            )
        ),
    )


def insensitive_parameters(
    goals: Sequence[MatchingTarget], search: Candidates
) -> Interval:
    """The parameters on which E does not depend at the best string that a search found.

    It cannot be said that a parameter is determined: a search narrows by itself, and
    may end beside a string that is better still. Each parameter is moved through its
    range, the others held.
    """
    parameters = goals[0].trial.model.parameters
    best = search.chi[search.best_index]
    scan = np.tile(best, (len(best), len(SCAN_EXPONENTS), 1))
    scan[np.arange(len(best)), :, np.arange(len(best))] = SCAN_EXPONENTS
    moved = scan.reshape(-1, len(best))
    chi = np.concatenate([search.chi, moved])
    rate = np.concatenate(
        [
            search.matching_rate,
            matching_rate(goals, parameter_values(parameters, moved)),
        ]
    )
    width = np.ptp(
        chi[rate >= search.matching_rate[search.best_index] - EQUAL_RATE_TOLERANCE],
        axis=0,
    )
    found = (
        (width < UNDETERMINED_SPREAD)
        & (best > BOUND_TOLERANCE)
        & (best < 1 - BOUND_TOLERANCE)
    )
    unknown = np.full(len(best), np.nan)
    loose = describe_undetermined(
        parameters, found, "Near the best string found, E depends on every parameter."
    )
    sentence = (
        f"{loose} How sure the others are, a search on E cannot say; least squares can."
    )
    return Interval(unknown, unknown, np.zeros(len(best), dtype=bool), sentence)


def describe_undetermined(
    parameters: Sequence[Parameter], determined: np.ndarray, clear: str
) -> str:
    """The parameters that the data cannot determine, in a sentence; `clear` if there
    are none.
    """
    loose = [
        parameter_label(p)
        for p, good in zip(parameters, determined, strict=True)
        if not good
    ]
    if not loose:
        return clear
    why = "other values fit as well, or the best lies at the end of the range"
    return f"This data cannot determine {', '.join(loose)}: {why}."


def parameter_label(parameter: Parameter) -> str:
    """Its name, as in settings and tables, and the paper's symbol where it has one."""
    return (
        f"{parameter.name} ({parameter.symbol})" if parameter.symbol else parameter.name
    )


def describe_correlated(
    parameters: Sequence[Parameter], determined: np.ndarray, correlation: np.ndarray
) -> str:
    """The parameters, not all determined, that the data determines only in combination,
    in a sentence. correlation: (P, P).
    """
    names = [parameter_label(p) for p in parameters]
    pairs = [
        f"{names[i]} and {names[j]} (correlation {correlation[i, j]:+.2f})"
        for i, j in zip(*np.triu_indices(len(names), 1), strict=True)
        if abs(correlation[i, j]) > MAX_CORRELATION
        and not (determined[i] and determined[j])
    ]
    return f" It knows only together: {', '.join(pairs)}." if pairs else ""


def describe_bad_fit(rate: float, rms: float, length: float) -> str:
    """A warning about a model that does not fit, whose parameters mean little; empty if
    it fits. rms, length [m].
    """
    if rate >= MIN_MATCHING_RATE and rms < MAX_RMS_SHARE * length:
        return ""
    return (
        f"The model does not explain this data (E = {rate:.2f}, {rms * 1e3:.0f} mm between the simulated string and "
        "the measured one): its parameters mean little."
    )


def _parameter_table(
    parameters: Sequence[Parameter],
    value: np.ndarray,
    chi: np.ndarray,
    interval: Interval,
) -> pd.DataFrame:
    bound = (chi <= BOUND_TOLERANCE) | (chi >= 1 - BOUND_TOLERANCE)
    ends = [
        [p.value(np.asarray(c)) for p, c in zip(parameters, end, strict=True)]
        for end in (interval.low, interval.high)
    ]
    return pd.DataFrame(
        {
            "name": [p.name for p in parameters],
            "symbol": [p.symbol for p in parameters],
            "unit": [p.unit for p in parameters],
            "meaning": [p.meaning for p in parameters],
            "value": value,
            "low": np.array(ends[0], dtype=float),
            "high": np.array(ends[1], dtype=float),
            "minimum": [p.low for p in parameters],
            "maximum": [p.high for p in parameters],
            "chi": chi,
            "at_bound": bound,
            "determined": interval.determined,
        }
    )


def _value_columns(
    parameters: Sequence[Parameter], chi: np.ndarray
) -> dict[str, np.ndarray]:
    """Values at exponents (C, P), by parameter."""
    return dict(
        zip(
            (p.name for p in parameters),
            parameter_values(parameters, chi).T,
            strict=True,
        )
    )
