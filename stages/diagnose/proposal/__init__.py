"""The motion that decides between look-alikes, taken from the last diagnosis."""

from __future__ import annotations

from stringcast.data.artifacts import Motion
from stringcast.data.diagnoses import Diagnosis
from stringcast.stages.spec import LatestIteration, StageCall, StageSpec


def run(call: StageCall, diagnosis: Diagnosis) -> Motion:
    """Take the motion that the last diagnosis proposed."""
    assert diagnosis.motion is not None
    return diagnosis.motion


STAGE = StageSpec(
    name="propose",
    makes=Motion,
    folder="motion",
    uses=(),
    run="stages.diagnose.proposal.run",
    inputs={"diagnosis": LatestIteration(Diagnosis)},
)
