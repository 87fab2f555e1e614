"""Uncertainty of a centre-line: the standard deviation of each point's coordinates.

Across the line, noise, texture and coding leave light next to the string that displaces
the centroid. Along the line, a point lies at a fixed share of the length: an error of
the end stretches the whole line, and a hidden part may be longer than it is drawn.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import distance_transform_edt

from stringcast.stages.common import rms

# Offset of the light's middle from the string's, relative to the half width.
CENTRE_ERROR_SHARE = 0.005
MIN_SIGMA_PX = 0.03  # error of sampling by pixels
SMOOTHED_NOISE_SHARE = 0.8  # of the centroid's noise, after averaging along the line
NOISE_CORRELATION_PX = 2.0  # of noise in a blurred picture, across the line
HIDDEN_SLOPE_SIGMA = 0.2  # [px/px] change of direction in a hidden part
# Error of a centroid in the arm's outline, relative to the half width. The outline may
# hide the light of half the string at one side, which shifts the centroid by up to half
# the half width. Measured in films of strings C and D: 0.23 to 0.27.
OUTLINE_ERROR_SHARE = 0.5 / np.sqrt(3)
END_SLOPE_SIGMA = 0.02  # [px/px] error of the direction of an extension
HIDDEN_LENGTH_SIGMA = 0.03  # [px/px] error of the length of a hidden part


def centroid_sigma(
    bright: np.ndarray,
    across: np.ndarray,
    unseen: np.ndarray,
    outlined: np.ndarray,
    noise: float,
    half_width: float,
) -> np.ndarray:
    """Estimate the standard deviation of the centroid across a line.

    Parameters
    ----------
    bright : (K, A) array
        Light across the line at each of its points [grey levels].
    across : (A,) array
        Distances of the samples from the line [px].
    unseen : (K,) bool array
        Whether a point is hidden, and the line is extended across it.
    outlined : (K,) bool array
        Whether the arm's outline may hide a part of the light.
    noise : float
        Standard deviation of the light at one pixel [grey levels].
    half_width : float
        Half the string's width [px].

    Returns
    -------
    (K,) array
        Standard deviation [px]. It contains the displacement by light outside the
        string.
    """
    total = np.maximum(bright.sum(axis=1), 4 * noise)
    inside = np.abs(across) <= 1.3 * half_width + 1
    spacing = across[1] - across[0]
    lever = np.sqrt(np.sum(across[inside] ** 2) * NOISE_CORRELATION_PX / spacing)
    by_noise = SMOOTHED_NOISE_SHARE * noise * lever / total
    displacement = (bright * across)[:, ~inside].sum(axis=1) / total
    by_light_outside = rms(displacement[~unseen])
    by_outline = OUTLINE_ERROR_SHARE * half_width * (outlined & ~unseen)
    by_extension = HIDDEN_SLOPE_SIGMA * distance_transform_edt(unseen)
    variance = (
        np.where(unseen, 0, by_noise) ** 2
        + by_light_outside**2
        + by_outline**2
        + by_extension**2
        + MIN_SIGMA_PX**2
        + (CENTRE_ERROR_SHARE * half_width) ** 2
    )
    return np.sqrt(variance)


def point_sigmas(
    across: np.ndarray, unseen: np.ndarray, read_count: int, end_sigma: float
) -> np.ndarray:
    """Combine standard deviations across and along a line to that of a coordinate.

    Parameters
    ----------
    across : (K,) array
        Standard deviation across the line of points a pixel apart [px].
    unseen : (K,) bool array
        Whether a point is hidden.
    read_count : int
        Number of points before the extension to the end.
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
    return np.sqrt((across**2 + extension**2 + along) / 2)
