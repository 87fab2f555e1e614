"""The offset between the clocks of arm and camera, with a 95 % interval.

Geometry limits it to a window (`windows`), and the string model is fitted within it
(`fit`). The interval accounts for unknown effects of the library: large ones are fitted
(`hidden_causes`), small ones averaged out (`diagnose.clock_offsets`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from stringcast.data.artifacts import Observation
from stringcast.data.schema import DataError
from stringcast.stages.check.measured import CheckedTrial, without_spikes
from stringcast.stages.clock.fit import (
    OffsetProfile,
    explained_by_offset,
    fit_clock,
    fit_drift,
    profile_offset,
    refit_from,
    shift_observations,
)
from stringcast.stages.clock.hidden_causes import (
    average_by_evidence,
    fits_with_causes,
)
from stringcast.stages.clock.windows import (
    HARMLESS_OFFSET_S,
    Window,
    largest_possible_offset,
    onset_window,
    possible_windows,
    stretch_by_offset,
)
from stringcast.stages.common import Progress, partial_progress
from stringcast.stages.diagnose.clocks.clock_offsets import (
    DRIFT,
    MIN_EXPLAINED_FRACTION,
    OFFSET,
    STAMP_UNCERTAINTY_FRAMES,
    ClockFit,
    Interval,
    clock_background,
    clock_posterior,
    explains_more,
    fit_separate_offsets,
    offset_intervals,
    refit_with_one_offset,
    scatter_of_trials,
    slopes_by_offset,
    time_slopes,
    trials_differ,
)
from stringcast.stages.diagnose.evidence.background_effects import (
    Background,
    BackgroundPosterior,
)
from stringcast.stages.diagnose.trials.preparation import usable_trials
from stringcast.stages.inference.trial_data import ByTrial
from stringcast.stages.model.effects.clock_drift import ClockDrift
from stringcast.stages.model.model import Model

EDGE_S = 0.02  # margin of the search around the window
RIVAL_LOG_LIKELIHOOD = 30.0  # another peak of the profile is refitted if this near
RIVAL_DISTANCE = 4  # steps of the profile between two peaks
MIN_DRIFT = 0.005  # a drift is named if its whole interval exceeds this
NO_PRIOR = 1e-6  # negligible precision [1/s2]
DRIFT_PRIOR = 0.05  # standard deviation of the drift as a share of time
CLOCK_REMEDY = (
    "Add that to t of points, or import with --clock fit; if it is the arm that lags, "
    "say how well the clocks agree in dataset.yaml: 'clock: {low: -0.001, high: "
    "0.001}', or import with --clock=0,0.001"
)


@dataclass(frozen=True)
class ClockOffset:
    """The offset of two clocks.

    Attributes
    ----------
    by_trial : dict
        Offset to add to the camera's times of each trial [s].
    is_common : bool
        Whether all trials have the same offset.
    drift : Interval or None
        Gain of the arm's clock on the camera's within trials, as a share of time; None
        if none is detected.
    profile : pandas.DataFrame
        By offset [s], in the first trial: `stretch`, the distance of points beyond
        their arc length [m], and `log_likelihood` of the string model, to first order.
    """

    by_trial: Mapping[str, Interval]
    is_common: bool
    drift: Interval | None
    profile: pd.DataFrame

    @property
    def wrong_rate(self) -> Interval | None:
        """The drift if it is beyond the range that a diagnosis searches."""
        (rate,) = ClockDrift.parameters
        if self.drift is None or rate.low < self.drift.value < rate.high:
            return None
        return self.drift


@dataclass(frozen=True)
class FittedOffset:
    """An offset and the fits from which it was estimated, each with its window.

    There is one fit for all trials, or one for each.
    """

    clock: ClockOffset
    fits: Sequence[ClockFit]
    windows: Sequence[Window]

    def is_certainly_wrong(self) -> bool:
        """Return whether an offset beyond the range of a diagnosis explains the motion.

        It does if geometry excludes zero, or if it removes enough of the mean square
        misfit at the tip. The fit for this comparison takes seconds. A drift has
        already passed such a comparison.
        """
        if self.clock.wrong_rate is not None:
            return True
        # all trials have the interval of the first if one fit is for all
        intervals = self.clock.by_trial.values()
        for interval, fit, window in zip(
            intervals, self.fits, self.windows, strict=False
        ):
            if not _is_harmful(interval):
                continue
            if not window.low <= 0 <= window.high:
                return True
            if explained_by_offset(fit, -window.middle) >= MIN_EXPLAINED_FRACTION:
                return True
        return False


def estimate_clock_offset(
    model: Model,
    observations: Sequence[Observation],
    rng: np.random.Generator,
    progress: Progress = lambda share: None,
) -> ClockOffset:
    """Estimate the offset to add to the camera's times, with its uncertainty.

    model: a string without causes. observations: trials with points; those in which
    nothing moves are left out. Raises DataError if nothing moves, or if a trial cannot
    be used.
    """
    # Spikes seem to be beyond the string at the true offset, and bias the fit
    trials = []
    for observation in observations:
        trial = CheckedTrial(observation, model.arm, model.string.length)
        trials.append(without_spikes(trial))
    return fit_clock_offset(model, trials, rng, progress).clock


def fit_clock_offset(
    model: Model,
    trials: Sequence[CheckedTrial],
    rng: np.random.Generator,
    progress: Progress,
) -> FittedOffset:
    """Estimate the offset, and keep its fits.

    trials: without spikes. Other parameters are those of `estimate_clock_offset`.
    """
    windows = possible_windows(trials)
    used = [trial for trial in trials if trial.name in windows]
    if len(set(windows.values())) > 1:
        separate, _ = _estimate_separate_offsets(model, used, rng, progress)
        return separate

    window = windows[used[0].name]
    part = partial_progress(progress, 0, 2)
    plain_fit, profile = _fit_within(model, used, window, rng, part)
    common_fits = _likely_fits(plain_fit)
    if common_fits[0] is not plain_fit:
        profile = profile_offset(common_fits[0], window.half_width + EDGE_S)
    together = _describe_common(common_fits, profile, used, window)
    if together.clock.is_common:
        progress(1.0)
        return together
    near = _separate_offsets_near(common_fits[0], profile, used, window)
    if near is not None:
        progress(1.0)
        return near
    separate, joint_fit = _estimate_separate_offsets(model, used, rng, progress)
    # The search with one offset may have missed the string found with several
    offsets = [interval.value for interval in separate.clock.by_trial.values()]
    middle = float(np.median(offsets)) - window.middle
    common_fit = refit_with_one_offset(common_fits[0], joint_fit, middle)
    if explains_more(joint_fit, common_fit):
        return separate
    profile = profile_offset(common_fit, window.half_width + EDGE_S)
    together = _describe_common([common_fit], profile, used, window)
    return replace(together, clock=replace(together.clock, is_common=True))


def _separate_offsets_near(
    common: ClockFit,
    profile: OffsetProfile,
    trials: Sequence[CheckedTrial],
    window: Window,
) -> FittedOffset | None:
    """Estimate an offset for each trial, starting from a fit with one for all.

    Returns None if they are not accepted. Clocks that run at slightly different rates
    differ by some milliseconds from trial to trial.
    """
    frame_s = _longest_frame_interval_s(trials)
    separate, own = fit_separate_offsets(common, NO_PRIOR, frame_s)
    refitted = refit_with_one_offset(common, separate, float(np.median(own.mean)))
    if not explains_more(separate, refitted):
        return None
    by_trial = offset_intervals(
        [trial.name for trial in trials],
        window.middle + own.mean,
        own.standard_deviation,
        frame_s,
    )
    drift = _drift_of(separate, clock_background(separate))
    table = _profile_table(trials[0], window, profile)
    count = len(trials)
    offset = ClockOffset(by_trial, False, drift, table)
    return FittedOffset(offset, [common] * count, [window] * count)


def _estimate_separate_offsets(
    model: Model,
    trials: Sequence[CheckedTrial],
    rng: np.random.Generator,
    progress: Progress,
) -> tuple[FittedOffset, ClockFit]:
    """Estimate an offset for each trial, with one string for all.

    Each trial is fitted alone, because offsets may differ much. Then all are fitted
    together, shifted by these offsets. Also returns the best joint fit.
    """
    alone = {}
    fits = []
    windows = []
    profiles = []
    for number, trial in enumerate(trials):
        (window,) = possible_windows([trial]).values()
        part = partial_progress(progress, number, len(trials) + 1)
        clock, profile = _fit_within(model, [trial], window, rng, part)
        alone[trial.name] = window.middle + clock.offset
        fits.append(clock)
        windows.append(window)
        profiles.append(profile)

    shifted = shift_observations([trial.observation for trial in trials], alone)
    part = partial_progress(progress, len(trials), len(trials) + 1)
    joint_fit = fit_clock(model, shifted, EDGE_S, rng, part)
    joint_fits = _likely_fits(joint_fit)
    backgrounds = [clock_background(clock) for clock in joint_fits]
    posterior = _average_posterior(joint_fits, backgrounds, slopes_by_offset)
    values_s = np.array([*alone.values()]) + posterior.mean
    by_trial = offset_intervals(
        list(alone),
        values_s,
        posterior.standard_deviation,
        _longest_frame_interval_s(trials),
    )
    drift = _drift_of(joint_fits[0], backgrounds[0])
    table = _profile_table(trials[0], windows[0], profiles[0])
    offset = ClockOffset(by_trial, False, drift, table)
    return FittedOffset(offset, fits, windows), joint_fits[0]


def _describe_common(
    likely_fits: Sequence[ClockFit],
    profile: OffsetProfile,
    trials: Sequence[CheckedTrial],
    window: Window,
) -> FittedOffset:
    """Describe the common offset of likely fits to all trials, the best first."""
    frame_s = _longest_frame_interval_s(trials)
    floor = STAMP_UNCERTAINTY_FRAMES * frame_s
    backgrounds = [clock_background(clock) for clock in likely_fits]
    own = _average_posterior(likely_fits, backgrounds, slopes_by_offset)
    scatter_s = scatter_of_trials(own)
    interval = _common_offset(likely_fits, backgrounds, window.middle, floor, scatter_s)
    estimate = ClockOffset(
        by_trial=dict.fromkeys([trial.name for trial in trials], interval),
        is_common=not trials_differ(own, frame_s),
        drift=_drift_of(likely_fits[0], backgrounds[0]),
        profile=_profile_table(trials[0], window, profile),
    )
    return FittedOffset(estimate, [likely_fits[0]], [window])


def _fit_within(
    model: Model,
    trials: Sequence[CheckedTrial],
    window: Window,
    rng: np.random.Generator,
    progress: Progress,
) -> tuple[ClockFit, OffsetProfile]:
    """Fit the string and one offset within a window, and profile the offset."""
    half_width = window.half_width + EDGE_S
    middle = {trial.name: window.middle for trial in trials}
    shifted = shift_observations([trial.observation for trial in trials], middle)
    clock = fit_clock(model, shifted, half_width, rng, progress)
    profile = profile_offset(clock, half_width)
    rival = _rival_peak(profile.log_likelihood, profile.offsets, clock.offset)
    if rival is not None:
        clock = refit_from(clock, profile.chi[rival])
    return clock, profile


def _profile_table(
    trial: CheckedTrial, window: Window, profile: OffsetProfile
) -> pd.DataFrame:
    """Build the table of a profile, with the stretch of points in a trial."""
    offsets = window.middle + profile.offsets
    columns = {
        "offset": offsets,
        "stretch": stretch_by_offset(trial, offsets),
        "log_likelihood": profile.log_likelihood - profile.log_likelihood.max(),
    }
    return pd.DataFrame(columns)


def _common_offset(
    likely_fits: Sequence[ClockFit],
    backgrounds: Sequence[Background],
    added: float,
    floor: float,
    scatter_s: float,
) -> Interval:
    """Return the offset that all trials share.

    backgrounds: the response of each fit to other effects. added: offset added to the
    camera's times before the fits [s]. floor: uncertainty of time stamps, added to the
    half width of the interval [s]. scatter_s: scatter of the trials' own offsets.
    """
    posterior = _average_posterior(likely_fits, backgrounds, _slopes_by_one_offset)
    deviation_of_mean_s = scatter_s / np.sqrt(len(likely_fits[0].data.trials))
    deviation_s = np.hypot(posterior.standard_deviation[0], deviation_of_mean_s)
    return Interval.from_deviation(added + posterior.mean[0], deviation_s, floor)


def find_wrong_clock(
    model: Model,
    observations: Sequence[Observation],
    rng: np.random.Generator,
    progress: Progress = lambda share: None,
) -> ClockOffset | None:
    """Return the offset of clocks that certainly differ, or None.

    The string model is fitted only if geometry allows larger offsets than a diagnosis
    searches. The offset is certain only if it explains the motion: an incomplete model
    may fit a little better at any offset. Trials that cannot be used, or that do not
    begin at rest, are left out. Parameters are those of `estimate_clock_offset`.
    """
    resting = [without_spikes(trial) for trial in resting_trials(model, observations)]
    if largest_possible_offset(resting) < HARMLESS_OFFSET_S:
        return None
    fitted = fit_clock_offset(model, resting, rng, progress)
    return fitted.clock if fitted.is_certainly_wrong() else None


def resting_trials(
    model: Model, observations: Sequence[Observation]
) -> list[CheckedTrial]:
    """Select the usable trials that begin at rest and in which something moves."""
    usable, _ = usable_trials(model, observations)
    resting = []
    for observation in usable:
        trial = CheckedTrial(observation, model.arm, model.string.length)
        if onset_window(trial) is not None:
            resting.append(trial)
    return resting


def _is_harmful(interval: Interval) -> bool:
    """Return whether an interval lies beyond the range that a diagnosis searches."""
    return max(interval.low, -interval.high) > HARMLESS_OFFSET_S


def refuse_wrong_clock(
    model: Model,
    observations: Sequence[Observation],
    rng: np.random.Generator,
) -> None:
    """Raise DataError with the offset for trials whose clocks certainly differ."""
    clock = find_wrong_clock(model, observations, rng)
    if clock is not None:
        raise wrong_clock_error(clock, "points t")


def wrong_clock_error(clock: ClockOffset, place: str) -> DataError:
    """Describe clocks that certainly differ, and what to do."""
    if clock.wrong_rate is not None:
        ratio = 1 / (1 + clock.wrong_rate.value)
        fault = f"{describe_drift(clock.wrong_rate)}: its frame rate is wrong"
        remedy = f"Give {ratio:.3f} times the rate with --fps, or divide t by that"
        return DataError(place, fault, remedy)
    name, worst = max(clock.by_trial.items(), key=lambda item: abs(item[1].value))
    value, low, high = worst.in_milliseconds()
    where = "" if clock.is_common else f" in trial {name}"
    fault = (
        f"the clocks of arm and camera differ by {value:+.0f} ms{where} (95 % interval "
        f"{low:+.0f} to {high:+.0f} ms), according to the motion of hand and string"
    )
    return DataError(place, fault, CLOCK_REMEDY)


def describe_drift(drift: Interval) -> str:
    """State how much slower or faster the camera's clock runs than the arm's."""
    direction = "slow" if drift.value > 0 else "fast"
    low, high = sorted(100 * abs(end) for end in (drift.low, drift.high))
    return (
        f"the camera's clock seems to run {100 * abs(drift.value):.1f} % {direction} "
        f"(95 % interval {low:.1f} to {high:.1f} %)"
    )


def _rival_peak(
    log_likelihood: np.ndarray, offsets: np.ndarray, best: float
) -> int | None:
    """Return the index of the highest peak of a profile away from the fit's offset."""
    nearest = int(np.argmin(np.abs(offsets - best)))
    level = log_likelihood[nearest] - RIVAL_LOG_LIKELIHOOD
    is_distant = np.abs(np.arange(len(offsets)) - nearest) >= RIVAL_DISTANCE
    inner = np.concatenate([[-np.inf], log_likelihood, [-np.inf]])
    is_peak = (inner[1:-1] >= inner[:-2]) & (inner[1:-1] >= inner[2:])
    candidates = np.flatnonzero(is_peak & is_distant & (log_likelihood > level))
    if not len(candidates):
        return None
    return int(candidates[np.argmax(log_likelihood[candidates])])


def _slopes_by_one_offset(clock: ClockFit) -> ByTrial:
    """Return derivatives by the offset of all trials, (1, 2 n)."""
    return [slope[None] for slope in time_slopes(clock)]


def _average_posterior(
    likely_fits: Sequence[ClockFit],
    backgrounds: Sequence[Background],
    columns: Callable[[ClockFit], ByTrial],
) -> BackgroundPosterior:
    """Compute the posterior of offsets without a prior, averaged over fits.

    columns: derivatives of a fit's residuals by each of the offsets.
    """
    posteriors = []
    for clock, background in zip(likely_fits, backgrounds, strict=True):
        by_offset = columns(clock)
        precision = np.full(len(by_offset[0]), NO_PRIOR)
        steps = clock_posterior(clock, background, by_offset, precision)
        posteriors.append(replace(steps, mean=steps.mean + clock.offset))
    return average_by_evidence(likely_fits, posteriors)


def _likely_fits(plain_fit: ClockFit) -> list[ClockFit]:
    """List likely fits, with a cause or a drift within trials, the best first."""
    fits = fits_with_causes(plain_fit)
    drift = _linear_drift(fits[0], clock_background(fits[0]))
    if max(drift.low, -drift.high) < MIN_DRIFT:
        return fits
    # A cause may have stood in for the drift, so they are sought again
    drifting = fits_with_causes(fit_drift(plain_fit))
    return drifting if explains_more(drifting[0], fits[0]) else fits


def _drift_of(clock: ClockFit, background: Background) -> Interval | None:
    """Return the drift of a fit; None if it has none."""
    return _linear_drift(clock, background) if DRIFT in clock.fit.values else None


def _linear_drift(clock: ClockFit, background: Background) -> Interval:
    """Estimate the drift, linear at a fit with or without one."""
    columns = []
    slopes = time_slopes(clock)
    for trial, slope in zip(clock.data.trials, slopes, strict=True):
        columns.append(np.stack([slope, slope * np.repeat(trial.point_times, 2)]))
    precision = np.array([NO_PRIOR, DRIFT_PRIOR**-2])
    steps = clock_posterior(clock, background, columns, precision, (OFFSET, DRIFT))
    drift = clock.fit.values.get(DRIFT, 0.0) + steps.mean[1]
    return Interval.from_deviation(drift, steps.standard_deviation[1], 0.0)


def _longest_frame_interval_s(trials: Sequence[CheckedTrial]) -> float:
    """Find the longest median time between two frames of a trial [s]."""
    return max(float(np.median(np.diff(trial.frame_t))) for trial in trials)
