"""Trials made by hand: points that were seen, and poses of the grasp."""

import numpy as np
import pandas as pd

from stringcast.data.artifacts import MASKS, READINGS, Observation


def observe_points(
    name: str,
    t: np.ndarray,
    places: np.ndarray,
    seen: np.ndarray,
    sigma: float,
    **fields,
) -> Observation:
    """Return a trial of points that were seen at the same places in each frame.

    Parameters
    ----------
    name : of the trial
    t : (F,) times of the frames [s]
    places : (M,) arc lengths [m]
    seen : (F, M, 2) positions [m]
    sigma : noise of a coordinate [m]
    fields : others of the trial, such as `grasp`
    """
    x, y = seen.reshape(-1, 2).T
    s = np.tile(places, len(t))
    columns = {"t": t.repeat(len(places)), "s": s, "x": x, "y": y}
    points = pd.DataFrame(columns | {"sigma": sigma, "valid": True})
    return Observation(name, points, READINGS.empty(), MASKS.empty(), **fields)


def grasp_table(t: np.ndarray, pose: np.ndarray) -> pd.DataFrame:
    """Return poses (K, 3) of the grasp at times (K,) [s] as a table."""
    x, y, theta = pose.T
    return pd.DataFrame({"t": t, "x": x, "y": y, "theta": theta})
