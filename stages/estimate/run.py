"""Run the stage estimate."""

from __future__ import annotations

from stringcast.data.artifacts import TrialSet
from stringcast.data.estimates import Estimate
from stringcast.stages.estimate.trim import trim_at_contact
from stringcast.stages.spec import StageCall


def run(call: StageCall, trials: TrialSet, estimate: Estimate | None) -> Estimate:
    """Estimate from trials until their string touches an obstacle.

    estimate: the last estimate, where the search starts.
    """
    obstacles = call.setup.obstacles
    observations = [trim_at_contact(trial, obstacles) for trial in trials.observations]
    return call.by(
        call.setup.model,
        observations,
        estimate,
        seed=call.seed,
        cast_number=max(call.number, 1),  # a look has number 0
        progress=call.progress,
    )
