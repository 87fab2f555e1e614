"""Excite: choose the most informative motion for the alignment of camera and clock."""

from stringcast.data.artifacts import Motion
from stringcast.stages.spec import MODEL, StageSpec

STAGE = StageSpec(
    name="excite",
    makes=Motion,
    folder="motion",
    uses=(*MODEL, "obstacles", "excite", "seed"),
    run="stages.align.excitation.excite.run",
    by=("stages.align.excitation.excite.excite",),
)
