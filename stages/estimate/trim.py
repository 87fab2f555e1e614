"""Cut trials where their string touches an obstacle, which is not in the model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from stringcast.data.artifacts import Observation
from stringcast.stages.model.box import Box
from stringcast.stages.string_places import (
    places_wander,
    points_at_arc_lengths,
    track_places,
)

CONTACT_MARGIN_M = 0.01  # distance from an obstacle that counts as contact
MIN_FRAMES = 3  # before a contact, for a trial to be cut
SAMPLED_PLACES = 40  # along the string, if frames have different ones


def trim_at_contact(observation: Observation, obstacles: Sequence[Box]) -> Observation:
    """Cut a trial where its string first comes near an obstacle.

    Both the string's line and each point's path count. A trial with contact in its
    first frames or without points is returned whole.
    """
    points = observation.valid_points
    if not obstacles or points.empty:
        return observation
    times, lines = _string_lines(points.sort_values(["t", "s"], kind="stable"))
    near = np.zeros(len(lines), dtype=bool)
    margin = 2 * CONTACT_MARGIN_M
    for obstacle in obstacles:
        box = replace(obstacle, w=obstacle.w + margin, h=obstacle.h + margin)
        near |= box.is_crossed_along(lines).any(axis=1)
        near[1:] |= box.is_crossed_by(lines[:-1], lines[1:]).any(axis=1)
    contacts = np.flatnonzero(near)
    if not contacts.size or contacts[0] < MIN_FRAMES:
        return observation
    before = observation.points["t"] < times[contacts[0]]
    return replace(observation, points=observation.points[before])


def _string_lines(points: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
    """Return the positions of the same places in all frames.

    Returns times (F,) [s] and lines (F, S, 2) [m], NaN where a place was not seen.
    """
    times, frame = np.unique(points["t"], return_inverse=True)
    s, xy = points["s"].to_numpy(), points[["x", "y"]].to_numpy()
    if places_wander(s, track_places(frame, s)):
        places = np.linspace(s.min(), s.max(), SAMPLED_PLACES)
        return times, points_at_arc_lengths(frame, s, xy, places)
    wide = points.pivot_table(index="t", columns="s", values=["x", "y"])
    return times, np.stack([wide["x"].to_numpy(), wide["y"].to_numpy()], axis=-1)
