"""Clocks of arm and camera that differ from trial to trial.

Effects of the library shift all trials alike. So if a diagnosis leaves misfit, the
clocks of each trial are fitted, starting from its fit with the causes that it names.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from stringcast.stages.diagnose.clocks.clock_offsets import (
    ClockFit,
    Interval,
    explains_more,
    fit_separate_offsets,
    offset_intervals,
    posterior_of_trials,
    refit_with_one_offset,
    trials_differ,
)
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import Fit, fit_hypothesis
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.effects.time_offset import TimeOffset

# Of the prior of an offset [1/s^2]: 30 ms, larger ones are refused before
OFFSET_PRECISION = 0.03**-2


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
    own = posterior_of_trials(common, OFFSET_PRECISION)
    frame_s = max(float(np.median(np.diff(trial.times))) for trial in data.trials)
    if not trials_differ(own, frame_s):
        return None

    separate, own = fit_separate_offsets(common, OFFSET_PRECISION, frame_s)
    # The fit with one offset may have missed the string found with several
    common = refit_with_one_offset(common, separate, float(np.median(own.mean)))
    if not explains_more(separate, common):
        return None
    names = [trial.name for trial in data.trials]
    return offset_intervals(names, own.mean, own.standard_deviation, frame_s)


def _with_offset(hypothesis: Hypothesis) -> Hypothesis:
    """Make the offset of the clocks a parameter of the base model."""
    others = tuple(c for c in hypothesis.causes if c is not TimeOffset)
    return Hypothesis(hypothesis.base.with_effects(TimeOffset), others)


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
