"""Uncertainty of a centre-line: one sigma of a coordinate of each of its points, across
and along taken together.

Across, the centroid is displaced by the light that noise, texture or coding leave
beside the string. Along, a point lies where its share of the whole length is: an error
of the end stretches the whole line, and a hidden stretch may be longer than it is
drawn.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import distance_transform_edt

# of half the width: the middle of the light is not the middle of the string
PLACE_SIGMA_PX = 0.005
MIN_SIGMA_PX = 0.03  # [px] what sampling by pixels leaves
# of its noise that the shift keeps where it is averaged along the line
MEAN_FACTOR = 0.8
GRAIN_PX = 2.0  # [px] across over which noise of the blurred picture is the same
# [px/px] by how much the direction may change where nothing is seen
TURN_SIGMA_RAD = 0.2
AIM_SHARE = 0.01  # [px/px] by how much the end's direction may be off
HIDDEN_SHARE = 0.05  # [px/px] of the length that is drawn where nothing is seen


def centroid_sigma(
    bright: np.ndarray, across: np.ndarray, lost: np.ndarray, noise: float, half: float
) -> np.ndarray:
    """Sigma of the centroid of light across a line (K,) [px]. bright: (K, A) at
    distances across (A,) [px].

    noise: one sigma of light at one place. What is beside the string is not its: it
    says what draws the centroid.
    """
    total = np.maximum(bright.sum(axis=1), 4 * noise)
    inside = np.abs(across) <= 1.3 * half + 1
    own = (
        MEAN_FACTOR
        * noise
        * np.sqrt(np.sum(across[inside] ** 2) * GRAIN_PX / (across[1] - across[0]))
        / total
    )
    drawn = (bright * across)[:, ~inside].sum(axis=1) / total
    beside = np.sqrt(np.mean(drawn[~lost] ** 2))
    carried = TURN_SIGMA_RAD * distance_transform_edt(lost)
    return np.asarray(
        np.sqrt(
            np.where(lost, 0, own) ** 2
            + beside**2
            + carried**2
            + MIN_SIGMA_PX**2
            + (PLACE_SIGMA_PX * half) ** 2
        )
    )


def point_sigmas(
    across: np.ndarray, lost: np.ndarray, firm: int, end: float
) -> np.ndarray:
    """Sigma of a coordinate of each point (K,) [px], a pixel apart.

    across: (K,) its sigma across [px]. lost: (K,) where nothing is seen. firm: number
    of points before the line is carried on straight to its end. end: sigma of the end
    along the line [px].
    """
    number = np.arange(len(across))
    share = number / max(len(across) - 1, 1)
    before = np.cumsum(HIDDEN_SHARE * lost)
    along = ((1 - share) * before) ** 2 + share**2 * (
        (before[-1] - before) ** 2 + end**2
    )
    aimed = AIM_SHARE * np.maximum(number - firm, 0)
    return np.asarray(np.sqrt((across**2 + aimed**2 + along) / 2))
