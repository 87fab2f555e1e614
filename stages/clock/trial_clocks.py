"""Trials that each have a clock of their own."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stringcast.data.artifacts import Observation
from stringcast.stages.clock.offset import (
    ClockOffset,
    estimate_clock_offset,
    resting_trials,
)
from stringcast.stages.model.model import Model

MIN_TRIALS = 2  # the clocks of one trial differ from no others


def find_trial_clocks(
    model: Model, observations: Sequence[Observation], rng: np.random.Generator
) -> ClockOffset | None:
    """Return the offset of each trial's clocks if trials differ in it, or None.

    Effects of the library shift all trials alike. Trials that cannot be used, or do not
    begin at rest, are left out.

    Parameters
    ----------
    model : Model
        A string without causes.
    observations : sequence of Observation
    rng : numpy.random.Generator
    """
    resting = [trial.observation for trial in resting_trials(model, observations)]
    if len(resting) < MIN_TRIALS:
        return None
    clock = estimate_clock_offset(model, resting, rng)
    return None if clock.is_common else clock


def describe_trial_clocks(clock: ClockOffset) -> str:
    """Say between which offsets the clocks of trials lie, and how to correct them."""
    ordered = sorted(clock.by_trial.items(), key=lambda item: item[1].value)
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
