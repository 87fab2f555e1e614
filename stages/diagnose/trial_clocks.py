"""Clocks of arm and camera that differ from trial to trial.

Effects of the library shift all trials alike. So if a diagnosis leaves misfit, the
clocks of each trial are fitted, starting from its fit with the causes that it names.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from stringcast.stages.diagnose.background_effects import BackgroundPosterior
from stringcast.stages.diagnose.clock_offsets import (
    STAMP_UNCERTAINTY_FRAMES,
    ClockFit,
    Interval,
    clock_posterior,
    effect_responses,
    explains_more,
    refit_with_one_offset,
    slopes_by_offset,
    trials_differ,
)
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import Fit, fit_hypothesis
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.effects.time_offset import TimeOffset

OFFSET_DEVIATION_S = 0.03  # of the prior of an offset; larger ones are refused before
MAX_STEPS = 6  # of the offsets


def find_trial_clocks(data: TrialData, fit: Fit) -> Mapping[str, Interval] | None:
    """Return the offset of each trial's clocks if trials differ in it, or None.

    Parameters
    ----------
    data : TrialData
        The trials of a diagnosis.
    fit : Fit
        Its fit to them.

    Returns
    -------
    dict or None
        Offset to add to the camera's times of each trial [s].
    """
    if fit.has_diverged or len(data.trials) < 2:
        return None
    hypothesis = _with_offset(fit.hypothesis)
    start = hypothesis.model.exponents_of_values(fit.values)
    common_fit = fit_hypothesis(data, hypothesis, start[None], fit.grid_points)
    common = ClockFit(data, common_fit)
    own = _posterior_of_offsets(common)
    frame_s = max(float(np.median(np.diff(trial.times))) for trial in data.trials)
    if not trials_differ(own, frame_s):
        return None

    # Gauss-Newton steps of all offsets, each followed by a fit of the string
    separate = common
    shift_s = np.zeros(len(data.trials))
    for _ in range(MAX_STEPS):
        shift_s += own.mean
        separate = _refit_with_shifts(separate, own.mean)
        own = _posterior_of_offsets(separate)
        if np.ptp(own.mean) < STAMP_UNCERTAINTY_FRAMES * frame_s:
            break
    offset_s = shift_s + separate.offset + own.mean

    # The fit with one offset may have missed the string found with several
    common = refit_with_one_offset(common, separate, float(np.median(offset_s)))
    if not explains_more(separate, common):
        return None
    floor_s = STAMP_UNCERTAINTY_FRAMES * frame_s
    by_trial = {}
    for k, trial in enumerate(data.trials):
        deviation_s = own.standard_deviation[k]
        interval = Interval.from_deviation(offset_s[k], deviation_s, floor_s)
        by_trial[trial.name] = interval
    return by_trial


def _with_offset(hypothesis: Hypothesis) -> Hypothesis:
    """Make the offset of the clocks a parameter of the base model."""
    others = tuple(c for c in hypothesis.causes if c is not TimeOffset)
    return Hypothesis(hypothesis.base.with_effects(TimeOffset), others)


def _posterior_of_offsets(clock: ClockFit) -> BackgroundPosterior:
    """Compute the posterior of the trials' offsets, relative to the fit."""
    precision = np.full(len(clock.data.trials), OFFSET_DEVIATION_S**-2)
    background = effect_responses(clock)
    return clock_posterior(clock, background, slopes_by_offset(clock), precision)


def _refit_with_shifts(clock: ClockFit, shifts_s: np.ndarray) -> ClockFit:
    """Shift the times of trials by (K,) [s], and refit the string."""
    trials = []
    for trial, shift_s in zip(clock.data.trials, shifts_s.tolist(), strict=True):
        trials.append(trial.shift_times(shift_s))
    data = replace(clock.data, trials=tuple(trials))
    fit = clock.fit
    refitted = fit_hypothesis(data, fit.hypothesis, fit.chi[None], fit.grid_points)
    return ClockFit(data, refitted)


def describe_trial_clocks(by_trial: Mapping[str, Interval]) -> str:
    """Say between which offsets the clocks of trials lie, and how to correct them."""
    ordered = sorted(by_trial.items(), key=lambda item: item[1].value)
    ends = []
    for name, interval in (ordered[0], ordered[-1]):
        value, low, high = interval.in_milliseconds()
        ends.append(
            f"{value:+.1f} ms in {name} (95 % interval {low:+.1f} to {high:+.1f} ms)"
        )
    return (
        "The clocks of arm and camera seem to differ from trial to trial: what must be "
        f"added to the camera's times lies between {ends[0]} and {ends[1]}. If they "
        "were not synchronised, import the trials with --clock fit, and diagnose them "
        "again. A missing cause may look like this, too."
    )
