"""Where things really are that an aligned camera reports."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stringcast.data.artifacts import Points
from stringcast.stages.model.model import Model

# of the fixed point: each leaves a tenth of what was off, or less
FIXED_POINT_ROUNDS = 12


def transform_to_arm_frame(points: Points, model: Model) -> Points:
    """The points in the arm's frame, as far as the alignment was measured; times stay
    the camera's.

    For the hit test. A rolling shutter is left as it is: it depends on speeds.
    """
    if not model.measured_ranges:
        return points
    values = model.values({})[None]
    # at which the camera is asked for places that do not move
    moments = 3 if model.camera_effects else 1
    right = []
    for table, places in (
        (points.points, ["x", "y"]),
        (points.readings, ["tip_x", "tip_y"]),
    ):
        t, seen = table["t"].to_numpy(), table[places].to_numpy()
        true = seen
        for _ in range(FIXED_POINT_ROUNDS if len(table) else 0):
            reported = model.observed_points(
                np.tile(true[None, :, None], (1, moments, 1, 1)), values, t
            )
            true = true + seen - reported[0, :, 0]
        right.append(table.assign(**dict(zip(places, true.T, strict=True))))
    return replace(points, points=right[0], readings=right[1])
