"""The catalogue of single corrections."""

from __future__ import annotations

from stringcast.stages.check.consistency.corrections.arc_lengths import ARC_LENGTHS
from stringcast.stages.check.consistency.corrections.base import Correction
from stringcast.stages.check.consistency.corrections.directions import DIRECTIONS
from stringcast.stages.check.consistency.corrections.joints import joint_corrections
from stringcast.stages.check.consistency.corrections.lengths import (
    PositionsInPixels,
    ratio_corrections,
    unit_corrections,
)
from stringcast.stages.check.consistency.corrections.times import PACES, RATES
from stringcast.stages.check.consistency.record import Measurements
from stringcast.stages.model.camera import Camera


def single_corrections(
    measured: Measurements, camera: Camera | None
) -> list[Correction]:
    """Return all corrections that can be tried on measurements."""
    corrections: list[Correction] = [
        *unit_corrections(),
        *ratio_corrections(),
        *ARC_LENGTHS,
        *DIRECTIONS,
        *RATES,
        *PACES,
    ]
    if camera is not None:
        corrections.append(PositionsInPixels(camera))
    counts = {r.joints.shape[1] for r in measured.recordings if r.joints is not None}
    for count in counts:
        corrections += joint_corrections(count)
    return corrections
