"""A string hanging at rest: arc lengths of its points."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from stringcast.stages.check.consistency.record import REST_FRAMES, arm_poses
from stringcast.stages.common import step_lengths


def grasp_poses(
    motion: pd.DataFrame, links: np.ndarray, base: np.ndarray
) -> pd.DataFrame:
    """Compute poses of the grasp of a planar arm.

    Parameters
    ----------
    motion
        Columns q1, q2 ... hold joint angles [rad].
    links
        Lengths of the links (J,), base first [m].
    base
        Place of joint 1 (2,) [m].

    Returns
    -------
    DataFrame
        Columns x, y [m] and theta [rad], a row for each row of `motion`.
    """
    columns = [f"q{number + 1}" for number in range(len(links))]
    poses = arm_poses(motion[columns].to_numpy(), links, base)
    return pd.DataFrame(poses, index=motion.index, columns=["x", "y", "theta"])


def estimate_arc_lengths(
    points: pd.DataFrame, grasp: pd.DataFrame
) -> dict[str, np.ndarray]:
    """Estimate the arc length of each named point of a string at rest.

    At rest a limp string hangs straight, so that distances from the grasp on, from
    point to point, are arc lengths. A stiff string bends below the grasp and is longer.

    Parameters
    ----------
    points
        Columns trial, t, point, x, y.
    grasp
        Columns trial, x, y [m], in the order of time.

    Returns
    -------
    dict
        Arc lengths by point [m], one for each trial, the nearest point first.
    """
    is_finite = np.isfinite(points[["x", "y"]]).all(axis=1)
    known = points[is_finite & points.get("valid", True)]
    by_time = known.sort_values("t", kind="stable")
    first = by_time.groupby(["trial", "point"]).head(REST_FRAMES)
    rest = first.groupby(["trial", "point"])[["x", "y"]].median()
    hands = grasp.groupby("trial")[["x", "y"]].first()
    arc_lengths: dict[str, list[float]] = {}
    for trial, places in rest.groupby(level="trial"):
        if trial not in hands.index:
            continue
        hand = hands.loc[trial]
        distance = np.linalg.norm(places - hand, axis=1)
        nearest_first = places.iloc[np.argsort(distance)]
        path = step_lengths(np.vstack([hand, nearest_first])).cumsum()
        names = nearest_first.index.get_level_values("point")
        for name, s in zip(names, path, strict=True):
            arc_lengths.setdefault(str(name), []).append(float(s))
    by_length = sorted(arc_lengths.items(), key=lambda item: item[1][0])
    return {name: np.array(values) for name, values in by_length}


def attach_arc_lengths(
    points: pd.DataFrame, arc_lengths: Mapping[str, float]
) -> pd.DataFrame:
    """Keep the points of known arc length [m], with that as column s."""
    known = points[points["point"].isin(list(arc_lengths))]
    return known.assign(s=known["point"].map(arc_lengths).astype(float))
