"""One estimation of a run, by whichever method its settings name."""

from __future__ import annotations

from stringcast.data.artifacts import Estimate, TrialSet
from stringcast.stages.estimate.trim import trim_at_contact
from stringcast.stages.spec import StageCall


def run(call: StageCall, trials: TrialSet, estimate: Estimate | None) -> Estimate:
    """Estimate from trials until their string touches an obstacle, beginning with the
    last estimate.
    """
    observations = [
        trim_at_contact(trial, call.setup.obstacles) for trial in trials.observations
    ]
    how = {"seed": call.seed, "manipulation": call.number, "progress": call.progress}
    made: Estimate = call.by(call.setup.model, observations, estimate, **how)
    return made
