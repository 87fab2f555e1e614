"""Where things really are that an aligned camera reports."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from stringcast.data.artifacts import Points
from stringcast.stages.model.model import Model

ROUNDS = 12  # of the fixed point: each leaves a tenth of what was off, or less


def in_arms_frame(points: Points, model: Model) -> Points:
    """The points in the arm's frame, as far as the alignment was measured; times stay the camera's.

    For the hit test. A rolling shutter is left as it is: it depends on speeds.
    """
    if not model.measured:
        return points
    places = ((points.points, ("x", "y")), (points.readings, ("tip_x", "tip_y")))
    lines, readings = (_moved(model, table, *columns) for table, columns in places)
    return replace(points, points=lines, readings=readings)


def _moved(model: Model, table: pd.DataFrame, x: str, y: str) -> pd.DataFrame:
    """A table with its places put right."""
    if table.empty:
        return table
    t, seen = table["t"].to_numpy(), table[[x, y]].to_numpy()
    true, values = seen, model.values({})[None]
    moments = 3 if model.camera_effects else 1  # at which the camera is asked for places that do not move
    for _ in range(ROUNDS):
        reported = model.reported(np.tile(true[None, :, None], (1, moments, 1, 1)), values, t)
        true = true + seen - reported[0, :, 0]
    return table.assign(**dict(zip((x, y), true.T, strict=True)))
