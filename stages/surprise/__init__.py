"""Surprise: test whether a trial agrees with its prediction."""

from stringcast.data.artifacts import Motion, Points, Trial
from stringcast.data.estimates import Estimate
from stringcast.data.explanations import Surprise
from stringcast.stages.spec import (
    MODEL,
    LatestIteration,
    SameIteration,
    StageSpec,
    StageSummary,
)


def summary(surprise: Surprise) -> StageSummary:
    """Summarise whether the trial is a surprise."""
    return StageSummary("surprise", surprise.sentence, surprise.surprise)


STAGE = StageSpec(
    name="surprise",
    makes=Surprise,
    folder="surprise",
    uses=(*MODEL, "seed"),
    run="stages.surprise.surprise.run",
    inputs={
        "motion": SameIteration(Motion),
        "trial": SameIteration(Trial),
        "points": SameIteration(Points),
        "last_motion": LatestIteration(Motion),
        "estimate": LatestIteration(Estimate),
    },
    summary=summary,
    is_end=True,
)
