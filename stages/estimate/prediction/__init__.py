"""Predict the string in a trial that was not used for the estimate."""

from stringcast.data.estimates import Estimate, Prediction
from stringcast.stages.spec import MODEL, CollectedTrials, LatestIteration, StageSpec

STAGE = StageSpec(
    name="predict",
    makes=Prediction,
    folder="prediction",
    uses=(*MODEL, "obstacles", "effects_per_recording"),
    run="stages.estimate.prediction.predict.run",
    inputs={"trials": CollectedTrials(), "estimate": LatestIteration(Estimate)},
    is_end=True,
)
