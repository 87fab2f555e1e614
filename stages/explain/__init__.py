"""Explain: find the causes of surprising trials within a budget of processor time."""

import pandas as pd

from stringcast.data.estimates import Estimate
from stringcast.data.explanations import Explanation, Surprise
from stringcast.stages.spec import (
    MODEL,
    CollectedTrials,
    LatestIteration,
    SameIteration,
    StageSpec,
    StageSummary,
)


def summary(explanation: Explanation) -> StageSummary:
    """Summarise the verdict and the causes that were compared."""
    table: pd.DataFrame = explanation.explanations.head(5)
    return StageSummary(explanation.verdict, explanation.sentence, table)


STAGE = StageSpec(
    name="explain",
    makes=Explanation,
    folder="explanation",
    uses=(*MODEL, "target", "obstacles", "explain", "trials_used", "seed"),
    run="stages.explain.run.run",
    inputs={
        "trials": CollectedTrials(),
        "estimate": SameIteration(Estimate),
        "surprise": SameIteration(Surprise),
        "previous": LatestIteration(Explanation),
    },
    by=("stages.explain.explain.explain",),
    summary=summary,
    is_end=True,
)
