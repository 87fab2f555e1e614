"""Propose: the motion that decides between look-alikes, as the last diagnosis found it."""

from __future__ import annotations

from stringcast.data.artifacts import Diagnosis, Motion
from stringcast.stages.spec import LatestIteration, StageCall, StageSpec


def run(call: StageCall, diagnosis: Diagnosis) -> Motion:
    """The motion of a diagnosis that has one."""
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
