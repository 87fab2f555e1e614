"""Build the Estimate artifact from candidates and scores, for every method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
import pandas as pd

from stringcast.data.estimates import (
    CANDIDATES,
    DRAWS,
    ESTIMATION_SUMMARY,
    MATCHING,
    MISFIT,
    PARAMETERS,
    Estimate,
)
from stringcast.data.schema import DataError
from stringcast.stages.estimate.matching import MatchingTarget, matching_rate
from stringcast.stages.estimate.posterior import sample_least_squares_posterior
from stringcast.stages.inference.prepared_trial import PreparedTrial
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import (
    Parameter,
    parameter_values,
)

EQUAL_RATE_TOLERANCE = 0.01  # difference of E within which candidates are equally good
UNDETERMINED_SPREAD = (
    0.5  # spread of a parameter's good values, as a share of its range
)
SCAN_EXPONENTS = np.linspace(0, 1, 21)  # at which each parameter is tried
MAX_CORRELATION = 0.95  # above which only a combination is determined
MIN_MATCHING_RATE = 0.6  # E below which the model does not explain the data
MAX_RMS_SHARE = 0.1  # of the string's length; a larger residual is not a fit
BOUND_TOLERANCE = 0.01  # share of a range within which a value is at its end


@dataclass(frozen=True)
class Candidates:
    """The candidates of a method, in order.

    Parameters
    ----------
    method
        Name of the method.
    chi
        Exponents, (C, P).
    matching_rate
        E, (C,); NaN where the simulation diverged.
    """

    method: str
    chi: np.ndarray
    matching_rate: np.ndarray

    def __post_init__(self) -> None:
        """Refuse a search in which every simulation diverged."""
        if np.isnan(self.matching_rate).all():
            raise DataError(
                self.method,
                f"none of {len(self.chi)} candidates stayed finite",
                "Narrow string.ranges, or look for jumps in the arm's joint angles.",
            )

    @property
    def best(self) -> np.ndarray:
        """Exponents (P,) of the candidate with the highest E."""
        return self.chi[np.nanargmax(self.matching_rate)]


@dataclass(frozen=True)
class Interval:
    """Uncertainty of the parameters.

    Parameters
    ----------
    low, high
        Ends of 95 % intervals in chi, (P,).
    determined
        Which parameters the data determine, (P,) bool.
    sentence
        Description in words.
    """

    low: np.ndarray
    high: np.ndarray
    determined: np.ndarray
    sentence: str


def start_chi(model: Model, previous: Estimate | None) -> np.ndarray:
    """Return the start of a search, (P,): the previous estimate or the start values."""
    known = {} if previous is None else previous.values()
    return model.exponents_of_values(known)


def build_search_estimate(
    targets: Sequence[MatchingTarget],
    before: np.ndarray,
    search: Candidates,
    seed: int,
) -> Estimate:
    """Build the artifact of a search on E; its best candidate is the estimate.

    Parameters
    ----------
    before
        Exponents of the start, (P,).
    seed
        Seed of the draws of the posterior.
    """
    interval = insensitive_parameters(targets, search)
    draws = sample_least_squares_posterior(targets, search.best, seed)
    return build_estimate(targets, before, search.best, search, interval, draws)


def build_estimate(
    targets: Sequence[MatchingTarget],
    before: np.ndarray,
    after: np.ndarray,
    search: Candidates,
    interval: Interval,
    draws: np.ndarray,
    mesh_errors: Sequence[np.ndarray] | None = None,
) -> Estimate:
    """Build the artifact of an estimation.

    Parameters
    ----------
    before, after
        Exponents of the start and of the estimate, (P,).
    search
        All candidates.
    draws
        Exponents drawn from the posterior, (K, P).
    mesh_errors
        Points on the mesh minus those on a much finer one, which were added to the
        measured points of each target, (N, 2) [m]; None if the mesh error was not
        subtracted.
    """
    if mesh_errors is None:
        mesh_errors = [np.zeros_like(target.trial.points) for target in targets]
    model = targets[0].trial.model
    parameters = model.parameters
    pair = parameter_values(parameters, np.stack([before, after]))
    comparison = _compare_with_trials(targets, pair, mesh_errors[-1])
    mesh_squares = [np.sum(error**2, axis=1).mean() for error in mesh_errors]
    rate = search.matching_rate
    finite = ~np.isnan(rate)
    rate_before = comparison.matching["before"].mean()
    rate_after = comparison.matching["after"].mean()
    rms, tip = comparison.rms, comparison.tip_rms
    bad_fit = describe_bad_fit(rate_after, rms[1], model.string.length)
    fit = {
        "method": search.method,
        "before": rate_before,
        "after": rate_after,
        "rms_before": rms[0],
        "rms_after": rms[1],
        "tip_before": tip[0],
        "tip_after": tip[1],
        "residual_ratio": comparison.residual_ratio,
        "mesh_error": np.sqrt(np.mean(mesh_squares)),
        "rejected": int((~finite).sum()),
        "sentence": bad_fit or interval.sentence,
    }

    best_so_far = np.fmax.accumulate(np.where(finite, rate, -np.inf))
    is_record = np.concatenate([[True], best_so_far[1:] > best_so_far[:-1]])
    tried = {
        "candidate": np.arange(len(rate)),
        "matching_rate": rate,
        "finite": finite,
        "accepted": is_record & finite,
    }
    numbered = {"draw": np.arange(len(draws))}
    return Estimate(
        parameter_table(parameters, after, interval),
        CANDIDATES.check(pd.DataFrame(tried | _value_columns(parameters, search.chi))),
        MATCHING.check(comparison.matching),
        ESTIMATION_SUMMARY.check(pd.DataFrame([fit])),
        DRAWS.check(pd.DataFrame(numbered | _value_columns(parameters, draws))),
        comparison.last_misfit,
    )


@dataclass(frozen=True)
class _Comparison:
    """Comparison of the strings before and after an estimation with the trials.

    Parameters
    ----------
    matching
        E of each frame: trial, t [s], before, after.
    rms, tip_rms
        Root mean square distance of the points, and of the tip, before and after,
        (2,) [m].
    residual_ratio
        Root mean square residual over the points' sigma after the estimation.
    last_misfit
        Misfit of the last trial's tip after the estimation.
    """

    matching: pd.DataFrame
    rms: np.ndarray
    tip_rms: np.ndarray
    residual_ratio: float
    last_misfit: pd.DataFrame


def _compare_with_trials(
    targets: Sequence[MatchingTarget], pair: np.ndarray, last_mesh_error: np.ndarray
) -> _Comparison:
    """Simulate each trial with the values before and after, (2, P), and compare.

    last_mesh_error: mesh error added to the points of the last trial, (N, 2) [m].
    """
    frames = []
    squares = []
    square_ratios = []
    for target in targets:
        trial = target.trial
        _, motion = next(trial.simulate(pair))
        old, new = target.rates_of_motion(motion)
        simulated = trial.sample_at_points(motion.points)  # (2, N, 2)
        columns = {"trial": trial.name, "t": trial.times, "before": old, "after": new}
        frames.append(pd.DataFrame(columns))
        squares.append([trial.mean_square_distances(points) for points in simulated])
        square_ratios.append(trial.mean_square_ratio(simulated[1]))

    last_misfit = tabulate_misfit(trial, simulated[1], last_mesh_error)
    rms, tip_rms = np.sqrt(np.mean(squares, axis=0)).T
    residual_ratio = float(np.sqrt(np.mean(square_ratios)))
    matching = pd.concat(frames, ignore_index=True)
    return _Comparison(matching, rms, tip_rms, residual_ratio, last_misfit)


def tabulate_misfit(
    trial: PreparedTrial, simulated: np.ndarray, mesh_error: np.ndarray
) -> pd.DataFrame:
    """Tabulate the misfit of the tip with simulated points (N, 2) [m] of a trial.

    mesh_error: mesh error added to the points of the trial, (N, 2) [m].
    """
    misfit = trial.points - mesh_error - simulated  # (N, 2)
    # the point nearest the tip in each frame
    order = np.lexsort((trial.s, trial.frame))
    is_last = np.append(np.diff(trial.frame[order]) > 0, True)
    tip = order[is_last]
    hand = trial.motion.actual_hand_motion(trial.model.arm, ())
    path = hand.pose[0]
    ticks = hand.start + hand.tick * np.arange(len(path))
    t = trial.point_times[tip]
    columns = {
        "t": t,
        "x": misfit[tip, 0],
        "y": misfit[tip, 1],
        "mesh_x": mesh_error[tip, 0],
        "mesh_y": mesh_error[tip, 1],
        "hand_x": np.interp(t, ticks, path[:, 0]),
        "hand_y": np.interp(t, ticks, path[:, 1]),
    }
    return MISFIT.check(pd.DataFrame(columns).dropna())


def insensitive_parameters(
    targets: Sequence[MatchingTarget], search: Candidates
) -> Interval:
    """Find the parameters on which E does not depend at the best candidate.

    Each parameter is varied over its range with the others fixed. No parameter is
    called determined, because a better string may exist elsewhere.
    """
    parameters = targets[0].trial.model.parameters
    best, count = search.best, len(search.best)
    scan = np.tile(best, (count, len(SCAN_EXPONENTS), 1))
    scan[np.arange(count), :, np.arange(count)] = SCAN_EXPONENTS
    scan = scan.reshape(-1, count)

    chi = np.concatenate([search.chi, scan])
    rate = np.concatenate([search.matching_rate, matching_rate(targets, scan)])
    good = rate >= np.nanmax(search.matching_rate) - EQUAL_RATE_TOLERANCE
    width = np.ptp(chi[good], axis=0)
    unknown = np.full(count, np.nan)
    sentence = describe_undetermined(
        parameters,
        width < UNDETERMINED_SPREAD,
        within_range(best, unknown, unknown),
        "Near the best string found, E depends on every parameter.",
    )
    sentence += " A search on E gives no intervals; least squares does."
    return Interval(unknown, unknown, np.zeros(count, dtype=bool), sentence)


def within_range(chi: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Find which exponents (P,) are not at an end of the range.

    An exponent near an end is not at it if its interval from `low` to `high` excludes
    the end. Unknown intervals are NaN.
    """
    is_far = (chi > BOUND_TOLERANCE) & (chi < 1 - BOUND_TOLERANCE)
    ends_before = (low > 0) & (high < 1)
    return is_far | ends_before


def describe_undetermined(
    parameters: Sequence[Parameter],
    is_narrow: np.ndarray,
    is_inside: np.ndarray,
    clear: str,
) -> str:
    """Name the parameters that the data cannot determine; `clear` if there are none.

    is_narrow, is_inside: (P,), whether only values near the best one fit, and whether
    the best one is not at an end of its range.
    """
    if (is_narrow & is_inside).all():
        return clear
    labels = np.array([parameter_label(parameter) for parameter in parameters])
    sentences = []
    if loose := ", ".join(labels[~is_narrow & is_inside]):
        sentences.append(
            f"This data cannot determine {loose}: other values fit as well."
        )
    if ends := ", ".join(labels[~is_inside]):
        sentences.append(
            f"This data cannot determine {ends}: the best value lies at an end of "
            "its range."
        )
    return " ".join(sentences)


def describe_correlated(
    parameters: Sequence[Parameter], determined: np.ndarray, correlation: np.ndarray
) -> str:
    """Name the pairs of parameters that the data determine only in combination.

    correlation: (P, P). In each pair at least one parameter is undetermined alone.
    """
    names = [parameter_label(parameter) for parameter in parameters]
    pairs = []
    for i, j in zip(*np.triu_indices(len(names), 1), strict=True):
        r = correlation[i, j]
        if abs(r) > MAX_CORRELATION and not (determined[i] and determined[j]):
            pairs.append(f"{names[i]} and {names[j]} (correlation {r:+.2f})")
    return f" Determined only in combination: {', '.join(pairs)}." if pairs else ""


def parameter_label(parameter: Parameter) -> str:
    """Return a parameter's name and, if it has one, its symbol in the paper."""
    name, symbol = parameter.name, parameter.symbol
    return f"{name} ({symbol})" if symbol else name


def describe_bad_fit(rate: float, rms: float, length: float) -> str:
    """Warn of a model that does not fit; empty if it fits. rms, length: [m]."""
    if rate >= MIN_MATCHING_RATE and rms < MAX_RMS_SHARE * length:
        return ""
    return (
        f"The model does not explain this data (E = {rate:.2f}, {rms * 1e3:.0f} mm "
        "between the simulated string and the measured one): do not trust its "
        "parameters."
    )


def parameter_table(
    parameters: Sequence[Parameter], chi: np.ndarray, interval: Interval
) -> pd.DataFrame:
    """Build table PARAMETERS of parameters with exponents (P,)."""
    ends = np.stack([chi, interval.low, interval.high])
    value, low, high = parameter_values(parameters, ends)
    described = pd.DataFrame([asdict(parameter) for parameter in parameters])
    described = described.rename(columns={"low": "minimum", "high": "maximum"})
    described = described[["name", "symbol", "unit", "meaning", "minimum", "maximum"]]
    table = described.assign(
        value=value,
        low=low,
        high=high,
        chi=chi,
        at_bound=~within_range(chi, interval.low, interval.high),
        determined=interval.determined,
    )
    return PARAMETERS.check(table)


def _value_columns(
    parameters: Sequence[Parameter], chi: np.ndarray
) -> dict[str, np.ndarray]:
    """Return the values at exponents (C, P) by parameter name."""
    values = parameter_values(parameters, chi)
    return {p.name: values[:, i] for i, p in enumerate(parameters)}
