"""Trials until their string touches an obstacle: what it does from there on the model
does not know.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from stringcast.data.artifacts import Observation
from stringcast.stages.common import places_wander, points_at_arc_lengths, track_places
from stringcast.stages.model.box import Box

# [m] of an obstacle at which a measured string may be touching it
CONTACT_MARGIN_M = 0.01
MIN_FRAMES = 3  # frames that are worth keeping
SAMPLED_PLACES = 40  # along the string, where every frame was measured at others


def trim_at_contact(observation: Observation, obstacles: Sequence[Box]) -> Observation:
    """The trial until its string first comes near an obstacle, seen along the string
    and on each point's way.

    One that is near from its first frames on stays whole, as does one of which no point
    was read.
    """
    points = observation.valid_points
    if not obstacles or points.empty:
        return observation
    times, lines = _string_lines(points.sort_values(["t", "s"], kind="stable"))
    near = np.zeros(len(lines), dtype=bool)
    for box in (
        replace(each, w=each.w + 2 * CONTACT_MARGIN_M, h=each.h + 2 * CONTACT_MARGIN_M)
        for each in obstacles
    ):
        near |= box.is_crossed_by(lines[:, :-1], lines[:, 1:]).any(axis=1)
        near[1:] |= box.is_crossed_by(lines[:-1], lines[1:]).any(axis=1)
    late = np.flatnonzero(near)
    if not late.size or late[0] < MIN_FRAMES:
        return observation
    return replace(
        observation, points=observation.points[observation.points["t"] < times[late[0]]]
    )


def _string_lines(points: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
    """Times (F,) [s], and where the same places are at all of them, (F, S, 2) [m], NaN
    where they were not seen.
    """
    times, frame = np.unique(points["t"], return_inverse=True)
    s, xy = points["s"].to_numpy(), points[["x", "y"]].to_numpy()
    if places_wander(s, track_places(frame, s)):
        return times, points_at_arc_lengths(
            frame, s, xy, np.linspace(s.min(), s.max(), SAMPLED_PLACES)
        )
    wide = points.pivot_table(index="t", columns="s", values=["x", "y"])
    return times, np.stack([wide["x"].to_numpy(), wide["y"].to_numpy()], axis=-1)
