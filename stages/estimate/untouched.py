"""Trials until their string touches an obstacle: what it does from there on the model does not know."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from data.artifacts import Observation
from stages.model.box import Box

NEAR = 0.01  # [m] of an obstacle at which a measured string may be touching it
FEWEST = 3  # frames that are worth keeping


def untouched(observation: Observation, obstacles: Sequence[Box]) -> Observation:
    """The trial until its string first comes near an obstacle, seen along the string and on each point's way.

    One that is near from its first frames on stays whole, as does one of which no point was read.
    """
    points = observation.read
    if not obstacles or points.empty:
        return observation
    wide = points.pivot_table(index="t", columns="s", values=["x", "y"])
    line = np.stack([wide["x"].to_numpy(), wide["y"].to_numpy()], axis=-1)
    late = np.flatnonzero(_near(line, obstacles))
    if not late.size or late[0] < FEWEST:
        return observation
    return replace(observation, points=observation.points[observation.points["t"] < wide.index[late[0]]])


def _near(line: np.ndarray, obstacles: Sequence[Box]) -> np.ndarray:
    """In which frames (F,) a string (F, S, 2) [m] is near an obstacle; points that were not measured are NaN."""
    near = np.zeros(len(line), dtype=bool)
    for box in (replace(each, w=each.w + 2 * NEAR, h=each.h + 2 * NEAR) for each in obstacles):
        near |= box.crossed(line[:, :-1], line[:, 1:]).any(axis=1)
        near[1:] |= box.crossed(line[:-1], line[1:]).any(axis=1)
    return near
