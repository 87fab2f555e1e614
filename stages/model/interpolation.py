"""Linear interpolation of rows in time or along a line."""

from __future__ import annotations

import numpy as np


def interpolate_rows(
    times: np.ndarray | float, t: np.ndarray, rows: np.ndarray
) -> np.ndarray:
    """Interpolate rows linearly; before the first and after the last they stay equal.

    Parameters
    ----------
    times : array of any shape
        Where rows are wanted.
    t : (K,) array
        Where they are known, ascending.
    rows : (K, D) array
        The rows.

    Returns
    -------
    (..., D) array
        A row for each of `times`.
    """
    columns = [np.interp(times, t, column) for column in rows.T]
    return np.stack(columns, axis=-1)
