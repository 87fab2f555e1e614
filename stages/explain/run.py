"""Run the stage explain."""

from __future__ import annotations

from stringcast.data.artifacts import TrialSet
from stringcast.data.estimates import Estimate
from stringcast.data.explanations import Explanation, Surprise
from stringcast.stages.estimate.trim import trim_at_contact
from stringcast.stages.spec import StageCall


def run(
    call: StageCall,
    trials: TrialSet,
    estimate: Estimate,
    surprise: Surprise,
    previous: Explanation | None,
) -> Explanation:
    """Explain trials until their string touches an obstacle."""
    setup = call.setup
    observations = [trim_at_contact(t, setup.obstacles) for t in trials.observations]
    target = setup.target
    return call.by(
        setup.model,
        observations,
        estimate,
        previous,
        surprise.is_surprising,
        min(target.w, target.h) / 2,
        seed=call.seed,
        cast_number=call.number,
        progress=call.progress,
    )
