"""Correct the points of an aligned camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stringcast.data.artifacts import Points
from stringcast.stages.model.model import Model

FIXED_POINT_ROUNDS = 12  # each reduces the error to a tenth or less


def transform_to_arm_frame(points: Points, model: Model) -> Points:
    """Move points to the arm's frame, as far as the model's alignment was measured.

    Times remain on the camera's clock. A rolling shutter is not corrected, because its
    effect depends on speeds.
    """
    if not model.measured_ranges:
        return points
    values = model.values({})[None]
    # a velocity needs points at three times; repeated points give a velocity of zero
    moments = 3 if model.camera_uses_velocity else 1
    corrected = []
    for table, columns in (
        (points.points, ["x", "y"]),
        (points.readings, ["tip_x", "tip_y"]),
    ):
        t, seen = table["t"].to_numpy(), table[columns].to_numpy()
        true = seen
        for _ in range(FIXED_POINT_ROUNDS if len(table) else 0):
            places = np.tile(true[None, :, None], (1, moments, 1, 1))
            reported = model.observed_points(places, values, t)
            true = true + seen - reported[0, :, 0]
        corrected.append(table.assign(**dict(zip(columns, true.T, strict=True))))
    return replace(points, points=corrected[0], readings=corrected[1])
