"""Extract: camera frames to the string's centre-line, tip and binary image (IV-B)."""

from stringcast.data.artifacts import Film, Points, Trial
from stringcast.stages.spec import SameIteration, StageSpec

STAGE = StageSpec(
    name="extract",
    makes=Points,
    folder="points",
    uses=("arm", "camera", "effects", "parameter_values", "extract"),
    run="stages.extract.extract.run",
    inputs={"trial": SameIteration(Trial | Film)},
    by=("stages.extract.extract.extract",),
)
