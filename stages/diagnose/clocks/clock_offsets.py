"""The offset between the clocks of arm and camera: its fits and its posterior.

Missing effects such as wind, a set or a lag would shift the offset. So each effect may
move the tip by a normal deviate. Its scale is common to all effects and estimated from
the data, as in `background_effects`, but with larger scales, up to the size of
unexplained misfit. This is linearised at the fit.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq
from scipy.special import chdtrc

from stringcast.stages.common import MS_PER_S, NORMAL_95, rms
from stringcast.stages.diagnose.evidence.background_effects import (
    Background,
    BackgroundPosterior,
    find_background,
    posterior_of_steps,
)
from stringcast.stages.diagnose.evidence.measures import (
    explained_fractions,
    unexplained_tip_rms,
)
from stringcast.stages.diagnose.search.proposals import candidate_effects
from stringcast.stages.diagnose.settings import INTERVAL_WIDENING
from stringcast.stages.inference.laplace import Fit, fit_hypothesis
from stringcast.stages.inference.likelihood import PRIOR_PRECISION
from stringcast.stages.inference.trial_data import ByTrial, TrialData
from stringcast.stages.model.library import effects_by_name

OFFSET = "time_offset.offset"
DRIFT = "clock_drift.rate"
# Effects that are the clock itself
CLOCK_EFFECTS = ("time_offset", "clock_drift")
MIN_EXPLAINED_FRACTION = 0.5  # of the misfit, for an offset that is certain
# Least uncertainty of a camera's time stamps, as a share of the time between frames
STAMP_UNCERTAINTY_FRAMES = 0.1
SIGNIFICANCE = 1e-3  # p-value below which trials do not have the same offset
MAX_SCALE_M = 0.1  # of the tip displacement by effects
MAX_STEPS = 20  # of separate offsets; ten were needed for differences of 0.1 s


class Interval(NamedTuple):
    """A value with a 95 % interval."""

    value: float
    low: float
    high: float

    @classmethod
    def from_deviation(cls, value: float, deviation: float, floor: float) -> Interval:
        """Return the interval of a value with a standard deviation."""
        half = INTERVAL_WIDENING * NORMAL_95 * deviation + floor
        return cls(float(value), float(value - half), float(value + half))

    def in_milliseconds(self) -> Interval:
        """Convert an interval in seconds to milliseconds."""
        return Interval(*(MS_PER_S * number for number in self))


@dataclass(frozen=True)
class ClockFit:
    """Trials with about correct times, and a fit of their remaining offset.

    Attributes
    ----------
    data : TrialData
    fit : Fit
        A fit whose parameters include the offset.
    """

    data: TrialData
    fit: Fit

    @property
    def index(self) -> int:
        """Index of the offset among the parameters."""
        return self.fit.hypothesis.model.names.index(OFFSET)

    @property
    def offset(self) -> float:
        """The offset to add to the camera's times [s]; a drift acts afterwards."""
        values = self.fit.values
        return values[OFFSET] / (1 + values.get(DRIFT, 0.0))


def better_fit(*fits: ClockFit) -> ClockFit:
    """Return the fit with the most evidence."""
    return max(fits, key=lambda clock: clock.fit.log_evidence)


def explains_more(fuller: ClockFit, simpler: ClockFit) -> bool:
    """Return whether a fit with more clock parameters is accepted.

    It must have more evidence and remove enough of the mean square misfit at the tip:
    if the string model is wrong, any clock parameter improves the fit a little. Both
    must hold without the trial that gains most, if there are others.
    """
    gain = fuller.fit.log_evidence - simpler.fit.log_evidence
    gains = fuller.fit.log_likelihood_by_trial - simpler.fit.log_likelihood_by_trial
    trials = np.arange(len(gains))
    if len(gains) > 1:
        most_helped = int(np.argmax(gains))
        gain -= gains[most_helped]
        trials = np.delete(trials, most_helped)
    explained = explained_fraction(fuller, simpler, trials)
    return bool(gain > 0 and explained >= MIN_EXPLAINED_FRACTION)


def explained_fraction(
    fuller: ClockFit, simpler: ClockFit, trials: np.ndarray | slice = slice(None)
) -> float:
    """Compute the share of the mean square misfit at the tip that a fit removes.

    It is 0 if neither fit leaves misfit. trials: indices of the trials that are used.
    """
    before = rms(unexplained_tip_rms(simpler.data, simpler.fit)[trials])
    after = rms(unexplained_tip_rms(fuller.data, fuller.fit)[trials])
    return float(explained_fractions(np.array(before), np.array(after)))


def refit_with_one_offset(
    common: ClockFit, separate: ClockFit, offset: float
) -> ClockFit:
    """Refit one offset to trials under the noise of a fit with separate offsets.

    The causes are those of that fit, too, so the evidence of both can be compared. The
    better of two fits is returned: one starts from the common fit, one from the other
    string and an offset [s].
    """
    trials = []
    for own, shifted in zip(common.data.trials, separate.data.trials, strict=True):
        trials.append(shifted.shift_times(own.times[0] - shifted.times[0]))
    data = replace(separate.data, trials=tuple(trials))
    causes = separate.fit.hypothesis.causes
    hypothesis = replace(common.fit.hypothesis, causes=causes)
    fits = []
    for values in (common.fit.values, {**separate.fit.values, OFFSET: offset}):
        start = hypothesis.model.exponents_of_values(values)
        grid_points = separate.fit.grid_points
        fits.append(fit_hypothesis(data, hypothesis, start[None], grid_points))
    return better_fit(*[ClockFit(data, fit) for fit in fits])


def posterior_of_trials(clock: ClockFit, precision: float) -> BackgroundPosterior:
    """Compute the posterior of each trial's own offset, relative to the fit.

    precision: of the prior of an offset [1/s^2].
    """
    columns = slopes_by_offset(clock)
    precisions = np.full(len(clock.data.trials), precision)
    return clock_posterior(clock, clock_background(clock), columns, precisions)


def fit_separate_offsets(
    common: ClockFit, precision: float, frame_s: float
) -> tuple[ClockFit, BackgroundPosterior]:
    """Fit an offset of each trial, and one string for all, from a fit with one offset.

    Gauss-Newton steps of all offsets are each followed by a fit of the string.

    Parameters
    ----------
    common : ClockFit
        The fit with one offset.
    precision : float
        Precision of the prior of an offset [1/s^2].
    frame_s : float
        Time between two frames [s]; steps end if they differ by a small part of it.

    Returns
    -------
    separate : ClockFit
        The fit to trials shifted by their offsets.
    own : BackgroundPosterior
        The posterior of the trials' offsets, in the times of the common fit.
    """
    separate = common
    own = posterior_of_trials(common, precision)
    shift_s = np.zeros(len(common.data.trials))
    for _ in range(MAX_STEPS):
        shift_s += own.mean
        separate = _refit_with_shifts(separate, own.mean)
        own = posterior_of_trials(separate, precision)
        if np.ptp(own.mean) < STAMP_UNCERTAINTY_FRAMES * frame_s:
            break
    return separate, replace(own, mean=shift_s + separate.offset + own.mean)


def _refit_with_shifts(clock: ClockFit, shifts_s: np.ndarray) -> ClockFit:
    """Shift the times of trials by (K,) [s], and refit the string."""
    trials = []
    for trial, shift_s in zip(clock.data.trials, shifts_s.tolist(), strict=True):
        trials.append(trial.shift_times(shift_s))
    data = replace(clock.data, trials=tuple(trials))
    fit = clock.fit
    refitted = fit_hypothesis(data, fit.hypothesis, fit.chi[None], fit.grid_points)
    return ClockFit(data, refitted)


def offset_intervals(
    names: Sequence[str],
    offsets_s: np.ndarray,
    deviations_s: np.ndarray,
    frame_s: float,
) -> dict[str, Interval]:
    """Return the interval of each trial's offset by its name.

    Parameters
    ----------
    names : sequence of str
        Names of the trials.
    offsets_s, deviations_s : numpy.ndarray, shape (K,)
        Offset of each trial, and its standard deviation [s].
    frame_s : float
        Time between frames [s], of which time stamps are uncertain by a share.
    """
    floor_s = STAMP_UNCERTAINTY_FRAMES * frame_s
    by_trial = {}
    for name, offset_s, deviation_s in zip(names, offsets_s, deviations_s, strict=True):
        by_trial[name] = Interval.from_deviation(offset_s, deviation_s, floor_s)
    return by_trial


def clock_background(clock: ClockFit) -> Background:
    """Find the background of all effects of the library at a clock fit."""
    model = clock.fit.hypothesis.model
    effects = candidate_effects(
        model, effects_by_name(), clock.data.trials, CLOCK_EFFECTS
    )
    return find_background(clock.data, clock.fit, effects, MAX_SCALE_M)


def time_slopes(clock: ClockFit) -> ByTrial:
    """Return derivatives of each trial's residuals by the offset, (2 n,) [1/s]."""
    fit, index = clock.fit, clock.index
    parameter = fit.hypothesis.parameters[index]
    seconds_per_exponent = float(parameter.slope(np.asarray(fit.chi[index])))
    return [slopes[index] / seconds_per_exponent for slopes in fit.slopes]


def clock_posterior(
    clock: ClockFit,
    background: Background,
    clock_columns: ByTrial,
    precision: np.ndarray,
    replaced: Collection[str] = (OFFSET,),
) -> BackgroundPosterior:
    """Compute the posterior of clock parameters relative to the fit.

    Parameters
    ----------
    clock : ClockFit
        The fit.
    background : Background
        Effects of up to MAX_SCALE_M.
    clock_columns : sequence of numpy.ndarray, shape (Q, 2 n)
        Derivatives of residuals by the clock parameters.
    precision : numpy.ndarray, shape (Q,)
        Precision of the clock parameters' normal priors, centred at the fit.
    replaced : collection of str
        Names of parameters of the fit that the columns replace.
    """
    fit = clock.fit
    is_kept = [name not in replaced for name in fit.hypothesis.model.names]
    slopes = []
    for columns, fit_slopes in zip(clock_columns, fit.slopes, strict=True):
        slopes.append(np.concatenate([columns, fit_slopes[is_kept]]))
    string_precision = np.full(sum(is_kept), PRIOR_PRECISION)
    steps = posterior_of_steps(
        clock.data,
        fit,
        slopes,
        np.concatenate([precision, string_precision]),
        background,
    )
    count = len(precision)
    return BackgroundPosterior(steps.mean[:count], steps.covariance[:count, :count])


def slopes_by_offset(clock: ClockFit) -> ByTrial:
    """Return derivatives by the offset of each trial, (K, 2 n)."""
    slopes = time_slopes(clock)
    columns = []
    for number, slope in enumerate(slopes):
        rows = np.zeros((len(slopes), len(slope)))
        rows[number] = slope
        columns.append(rows)
    return columns


def scatter_of_trials(own: BackgroundPosterior) -> float:
    """Estimate the scatter of the trials' own offsets beyond their posterior [s].

    Misfit of the model shifts the offset of each trial. The scatter is chosen to
    explain the differences (Paule and Mandel 1982, J. Res. NBS 87, 377).
    """
    freedom = len(own.mean) - 1
    excess = partial(_chi_squared_of_differences, own)
    if freedom < 1 or excess(0.0) <= freedom:
        return 0.0
    largest = np.ptp(own.mean) * np.sqrt(len(own.mean))
    return float(brentq(lambda scatter_s: excess(scatter_s) - freedom, 0.0, largest))


def _chi_squared_of_differences(own: BackgroundPosterior, scatter_s: float) -> float:
    """Compute chi squared of the differences between the trials' own offsets.

    scatter_s: added to their posterior.
    """
    count = len(own.mean)
    contrast = np.diff(np.eye(count), axis=0)
    difference = contrast @ own.mean
    scattered = own.covariance + scatter_s**2 * np.eye(count)
    covariance = contrast @ scattered @ contrast.T
    return float(difference @ np.linalg.solve(covariance, difference))


def trials_differ(own: BackgroundPosterior, frame_s: float) -> bool:
    """Return whether trials have significantly different offsets."""
    freedom = len(own.mean) - 1
    if freedom < 1 or np.ptp(own.mean) < frame_s:
        return False
    square = _chi_squared_of_differences(own, 0.0) / INTERVAL_WIDENING**2
    return bool(chdtrc(freedom, square) < SIGNIFICANCE)
