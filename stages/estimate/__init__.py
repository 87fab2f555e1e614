"""Estimate the string's parameters from trials, by one of three methods (IV)."""

from stringcast.data.estimates import Estimate
from stringcast.stages.spec import MODEL, CollectedTrials, LatestIteration, StageSpec

STAGE = StageSpec(
    name="estimate",
    makes=Estimate,
    folder="estimate",
    uses=(*MODEL, "obstacles", "estimate", "trials_used", "seed"),
    run="stages.estimate.run.run",
    inputs={"trials": CollectedTrials(), "estimate": LatestIteration(Estimate)},
    by=(
        "stages.estimate.random_search.estimate",
        "stages.estimate.cma_es.estimate",
        "stages.estimate.least_squares.estimate",
    ),
    is_end=True,
)
