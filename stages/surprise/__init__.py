"""The surprise as a stage: whether a trial is within what was predicted."""

from stringcast.data.artifacts import Motion, Points, Surprise
from stringcast.stages.spec import SameIteration, StageSpec, StageSummary


def summary(surprise: Surprise) -> StageSummary:
    """State in words and numbers whether the trial is a surprise."""
    return StageSummary("surprise", surprise.sentence, surprise.surprise)


STAGE = StageSpec(
    name="surprise",
    makes=Surprise,
    folder="surprise",
    uses=("seed",),
    run="stages.surprise.surprise.run",
    inputs={"motion": SameIteration(Motion), "points": SameIteration(Points)},
    summary=summary,
    is_end=True,
)
