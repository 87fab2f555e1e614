"""A string hanging at rest: its length, the arc lengths of its points, and when it
begins to move.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

# frames at the beginning, of which the median tells where a point rests
REST_FRAMES = 5


def grasp_poses(
    motion: pd.DataFrame, links: np.ndarray, base: np.ndarray
) -> pd.DataFrame:
    """Poses of the grasp: columns x, y [m], theta [rad], from joint angles q1, q2 ...
    [rad] of a planar arm.

    links: (J,) [m], base first. base: (2,) where joint 1 sits [m].
    """
    turned = np.cumsum(
        motion[[f"q{n + 1}" for n in range(len(links))]].to_numpy(), axis=1
    )
    place = [
        axis + (links * turn(turned)).sum(axis=1)
        for axis, turn in zip(base, (np.cos, np.sin), strict=True)
    ]
    return pd.DataFrame(
        {"x": place[0], "y": place[1], "theta": turned[:, -1]}, index=motion.index
    )


def estimate_arc_lengths(
    points: pd.DataFrame, grasp: pd.DataFrame
) -> dict[str, np.ndarray]:
    """Arc length of each of the string's named points [m], nearest first, by every
    trial (K,).

    At rest a limp string hangs straight, so that from the grasp on, in the order of
    their distance, points are as far from one another as along the string; a stiff one
    bends below the grasp, and is longer. points: columns trial, t, point, x, y. grasp:
    columns trial, x, y [m], in the order of time.
    """
    known = points[
        np.isfinite(points[["x", "y"]]).all(axis=1) & points.get("valid", True)
    ]
    first = (
        known.sort_values("t", kind="stable")
        .groupby(["trial", "point"])
        .head(REST_FRAMES)
    )
    # where each point rests at first
    rest = first.groupby(["trial", "point"])[["x", "y"]].median()
    hand = grasp.groupby("trial")[["x", "y"]].first()
    found: dict[str, list[float]] = {}
    for trial, there in rest.groupby(level="trial"):
        if trial not in hand.index:
            continue
        place = hand.loc[trial].to_numpy()
        xy = there.droplevel("trial")
        order = np.argsort(np.linalg.norm(xy.to_numpy() - place, axis=1))
        way = np.linalg.norm(
            np.diff(np.vstack([place, xy.to_numpy()[order]]), axis=0), axis=1
        ).cumsum()
        for name, s in zip(xy.index[order], way, strict=True):
            found.setdefault(str(name), []).append(float(s))
    return {
        name: np.array(values)
        for name, values in sorted(found.items(), key=lambda item: item[1][0])
    }


def attach_arc_lengths(points: pd.DataFrame, at: Mapping[str, float]) -> pd.DataFrame:
    """Points of which it is known how far along they lie, with that as column s [m]."""
    kept = points[points["point"].isin(list(at))]
    return kept.assign(s=kept["point"].map(at).astype(float))
