"""Generate: random joint-velocity curves whose simulated tip hits the target (III)."""

from stringcast.data.artifacts import Motion
from stringcast.data.estimates import Estimate
from stringcast.stages.spec import MODEL, LatestIteration, StageSpec

STAGE = StageSpec(
    name="generate",
    makes=Motion,
    folder="motion",
    uses=(*MODEL, "target", "obstacles", "generate", "seed"),
    run="stages.generate.generate.run",
    inputs={"motion": LatestIteration(Motion), "estimate": LatestIteration(Estimate)},
    by=("stages.generate.generate.generate", "stages.generate.robust.generate"),
)
