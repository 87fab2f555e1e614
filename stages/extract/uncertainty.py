"""Uncertainty of a centre-line: the standard deviation of each point's coordinates.

Across the line, noise, texture and coding leave light beside the string that displaces
the centroid. Along the line, a point lies at its share of the whole length: an error of
the end stretches the whole line, and a hidden stretch may be longer than it is drawn.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import distance_transform_edt

from stringcast.stages.common import rms

# offset of the light's middle from the string's, as a share of the half width
CENTRE_ERROR_SHARE = 0.005
MIN_SIGMA_PX = 0.03  # what sampling by pixels leaves
SMOOTHED_NOISE_SHARE = 0.8  # of the centroid's noise, after averaging along the line
NOISE_CORRELATION_PX = 2.0  # across, over which noise of a blurred picture is the same
HIDDEN_SLOPE_SIGMA = 0.2  # [px/px] change of direction where nothing is seen
END_SLOPE_SIGMA = 0.02  # [px/px] error of the direction in which a line is extended
HIDDEN_LENGTH_SIGMA = 0.05  # [px/px] error of the length drawn where nothing is seen


def centroid_sigma(
    bright: np.ndarray,
    across: np.ndarray,
    unseen: np.ndarray,
    noise: float,
    half_width: float,
) -> np.ndarray:
    """Estimate the standard deviation of the centroid across a line.

    Parameters
    ----------
    bright : (K, A) array
        Light across the line at each of its points [grey levels].
    across : (A,) array
        Distances from the line at which the light was sampled [px].
    unseen : (K,) bool array
        Whether nothing is seen at a point, and the line is extended across it.
    noise : float
        Standard deviation of the light at one pixel [grey levels].
    half_width : float
        Half the string's width [px].

    Returns
    -------
    (K,) array
        Standard deviation [px]. Light outside the string shows what displaces the
        centroid.
    """
    total = np.maximum(bright.sum(axis=1), 4 * noise)
    inside = np.abs(across) <= 1.3 * half_width + 1
    spacing = across[1] - across[0]
    lever = np.sqrt(np.sum(across[inside] ** 2) * NOISE_CORRELATION_PX / spacing)
    by_noise = SMOOTHED_NOISE_SHARE * noise * lever / total
    displacement = (bright * across)[:, ~inside].sum(axis=1) / total
    by_light_outside = rms(displacement[~unseen])
    by_extension = HIDDEN_SLOPE_SIGMA * distance_transform_edt(unseen)
    variance = (
        np.where(unseen, 0, by_noise) ** 2
        + by_light_outside**2
        + by_extension**2
        + MIN_SIGMA_PX**2
        + (CENTRE_ERROR_SHARE * half_width) ** 2
    )
    return np.asarray(np.sqrt(variance))


def point_sigmas(
    across: np.ndarray, unseen: np.ndarray, read_count: int, end_sigma: float
) -> np.ndarray:
    """Combine uncertainty across and along a line into that of one coordinate.

    Parameters
    ----------
    across : (K,) array
        Standard deviation across the line [px], of points a pixel apart.
    unseen : (K,) bool array
        Whether nothing is seen at a point.
    read_count : int
        Number of points before the line is extended to its end.
    end_sigma : float
        Standard deviation of the end along the line [px].

    Returns
    -------
    (K,) array
        Standard deviation of a coordinate [px].
    """
    number = np.arange(len(across))
    share = number / max(len(across) - 1, 1)
    hidden = np.cumsum(HIDDEN_LENGTH_SIGMA * unseen)
    to_end = (hidden[-1] - hidden) ** 2 + end_sigma**2
    along = ((1 - share) * hidden) ** 2 + share**2 * to_end
    extension = END_SLOPE_SIGMA * np.maximum(number - read_count, 0)
    return np.asarray(np.sqrt((across**2 + extension**2 + along) / 2))
