"""Segmentation: pixels brighter than the scene without the string."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from stringcast.data.lazy_module import LazyModule
from stringcast.stages.common import choose_evenly, mad_sigma
from stringcast.stages.extract.score import rasterise

cv2 = LazyModule("cv2")

WIDTH_SAMPLES = 15  # frames in which the string's width is measured
BRIGHTNESS_SAMPLES = 30  # frames in which the string's brightness is measured
BAND_ROWS = 16  # rows of all frames to sort at a time: about a megabyte
# Quantile of the frames without the arm at which the wall is not in shadow.
LIT_QUANTILE = 0.75
SHADOW_GREY = 4.0  # smallest darkening of the wall by a shadow [grey levels]
# Percentile over time at which a pixel shows the background. The string must leave it
# at least that often.
BACKGROUND_PERCENTILE = 3
# Distance from a resting grasp, over the string's length, within which the string may
# never leave its pixels.
STATIC_SHARE = 0.35
STILL_PX = 5.0  # a resting grasp moves less
# Width of the median that replaces these pixels; OpenCV's largest is 361.
MAX_MEDIAN_WIDTH_PX = 350
MIN_PATCH_PX = 12  # a smaller patch is the arm's edge or noise
OUTLINE_ERROR_PX = 1.0  # of the outline of a resting arm
MAX_LIGHT_GAIN = 5.0  # of the string's light in front of a bright arm
# With a larger error [grey levels], a pixel does not locate the string's middle.
MAX_OUTLINE_ERROR_GREY = 10.0
MAX_DARK_SIGMAS = 2.0  # largest darkening by noise
MIN_NOISE_GREY = 0.3  # noise of rounding to integers


@dataclass(frozen=True)
class Backdrop:
    """The scene behind the string, shared by all frames of a film.

    Parameters
    ----------
    scene : (height, width) grey levels without string and arm
    string : brightness of the string [grey levels]
    half_width : half the string's blurred width [px]
    sway : standard deviation of the camera's direction [px]
    """

    scene: np.ndarray
    string: float
    half_width: float
    sway: float


@dataclass(frozen=True)
class SegmentedFrame:
    """The string of one frame, each array (height, width).

    Parameters
    ----------
    light : brightness above the background, scaled as in front of the scene [grey
        levels]; noise makes it negative
    mask : certain pixels of the string, uint8
    arm : pixels where the arm may hide the string, bool
    outline : pixels where the arm's edge makes brightness uncertain, bool
    noise : standard deviation of the light [grey levels]
    """

    light: np.ndarray
    mask: np.ndarray
    arm: np.ndarray
    outline: np.ndarray
    noise: float


def segment_frame(
    image: np.ndarray,
    backdrop: Backdrop,
    arm_joints: np.ndarray,
    width: float,
    blur: float,
    sigmas: float,
) -> SegmentedFrame:
    """Segment the pixels of a frame that are neither scene nor arm.

    Parameters
    ----------
    image : (height, width) array
        The frame [grey levels].
    backdrop : Backdrop
        The scene behind the string.
    arm_joints : (M, J + 1, 2) array
        Samples of the arm's joints during the exposure [px].
    width : float
        Width of a link [px].
    blur : float
        Distance that the arm moves in the exposure [px]. The clock may have an error of
        half an exposure.
    sigmas : float
        Threshold in standard deviations of the noise.

    Returns
    -------
    SegmentedFrame
        The string's light and pixels.
    """
    expected, body, outline = expected_brightness(
        image, backdrop.scene, arm_joints, width, OUTLINE_ERROR_PX + blur / 2
    )
    above = cv2.GaussianBlur(image - expected, (0, 0), 0.8)
    noise = body_noise = grey_noise(above[::3, ::3])
    if body.any():
        body_noise = max(noise, grey_noise(above[body]))
    threshold = sigmas * np.where(body, body_noise, noise)
    mask = remove_specks((above > threshold).astype(np.uint8))
    arm = rasterise(arm_joints, image.shape, width + 4 + blur) > 0
    # In front of the arm, only light close to certain pixels is the string's.
    certain = ~body | (cv2.dilate(mask, np.ones((5, 5), np.uint8)) > 0)
    # Scaled to a typical part of the scene, because the contrast to a bright arm is
    # smaller.
    contrast = backdrop.string - expected
    typical = max(float(np.median(contrast)), MIN_NOISE_GREY)
    # Near an outline the expected brightness is only a bound, so light may be too dark.
    light = np.maximum(above, -MAX_DARK_SIGMAS * noise)
    light = light * typical / np.maximum(contrast, typical / MAX_LIGHT_GAIN)
    return SegmentedFrame(certain * light, mask, arm, outline, noise)


def estimate_background(
    frames: Sequence[np.ndarray],
    arm: Sequence[np.ndarray],
    uncovered: np.ndarray,
    half_width: float,
) -> np.ndarray:
    """Estimate the scene without string and arm.

    Pixels that are bright in few frames are string or arm. Where a shadow passes, the
    wall is also bright in some frames only, but over more than the string's width.

    Parameters
    ----------
    frames : sequence of F uint8 arrays (height, width)
        A sample of the film.
    arm : sequence of F arrays
        Masks of the arm in each, from `pack_mask`.
    uncovered : (height, width) array
        Result of `uncovered_brightness`.
    half_width : float
        Half the string's width [px].

    Returns
    -------
    (height, width) float32 array
        The scene [grey levels].
    """
    lit = _map_bands(_brightness_without_arm, frames, arm)
    brighter = np.maximum(lit - uncovered, 0)
    width = 2 * int(np.ceil(2 * half_width)) + 5
    square = np.ones((width, width), np.uint8)
    wide = cv2.morphologyEx(brighter, cv2.MORPH_OPEN, square)
    return uncovered + np.where(wide > SHADOW_GREY, wide, 0)


def uncovered_brightness(frames: Sequence[np.ndarray]) -> np.ndarray:
    """Estimate the brightness of each pixel without bright objects, float32."""
    levels = _map_bands(_low_and_median, frames)
    low, median = levels[..., 0], levels[..., 1]
    # By noise, a low percentile is darker than the scene.
    return low + np.median(median - low)


def _map_bands(
    function: Callable[..., np.ndarray], *films: Sequence[np.ndarray]
) -> np.ndarray:
    """Apply a function to bands of rows of all frames, which fit a processor's cache.

    function: maps stacks (F, rows, width), one for each film, to (rows, width, ...).
    """
    bands = []
    for first in range(0, len(films[0][0]), BAND_ROWS):
        rows = slice(first, first + BAND_ROWS)
        stacks = (np.stack([frame[rows] for frame in film]) for film in films)
        bands.append(function(*stacks))
    return np.concatenate(bands)


def _low_and_median(stack: np.ndarray) -> np.ndarray:
    """Compute low percentile and median of each pixel, (height, width, 2) float32."""
    ordered = _sorted_values(stack)
    low = _percentile(ordered, BACKGROUND_PERCENTILE)
    return np.stack([low, _percentile(ordered, 50)], axis=-1)


def _brightness_without_arm(stack: np.ndarray, arm: np.ndarray) -> np.ndarray:
    """Compute the brightness of pixels in lit frames without the arm, float32."""
    is_arm = unpack_mask(arm, stack.shape[-1])
    ordered = _sorted_values(np.where(is_arm, 0, stack))
    last = len(stack) - 1
    covered = is_arm.sum(axis=0)
    place = (covered + LIT_QUANTILE * (last - covered)).astype(int).clip(0, last)
    chosen = np.take_along_axis(ordered, place[..., None], axis=-1)
    return chosen[..., 0].astype(np.float32)


def pack_mask(mask: np.ndarray) -> np.ndarray:
    """Pack a mask (..., width) bool into bits; unpacked, a film's masks need 0.1 GB."""
    return np.packbits(mask, axis=-1)


def unpack_mask(mask: np.ndarray, width: int) -> np.ndarray:
    """Unpack a mask into (..., width) bool."""
    return np.unpackbits(mask, axis=-1, count=width).view(bool)


def typical_half_width(
    frames: Sequence[np.ndarray], scene: np.ndarray, arm: Sequence[np.ndarray]
) -> float:
    """Measure half the string's width in the more blurred frames [px].

    The brightest pixels relative to the scene, away from the arm, are the string.
    """
    widths = []
    for number in choose_evenly(len(frames), WIDTH_SAMPLES):
        covered = unpack_mask(arm[number], scene.shape[1]).astype(np.uint8)
        near_arm = cv2.dilate(covered, np.ones((5, 5))) > 0
        above = np.where(near_arm, 0, frames[number] - scene)
        bright = (above > above.max() / 2).astype(np.uint8)
        widths.append(mask_half_width(remove_specks(bright)))
    return float(np.percentile(widths, 90))


def mask_half_width(mask: np.ndarray) -> float:
    """Measure half the width of a mask: distance of inner pixels from the edge [px]."""
    if not mask.any():
        return 1.0
    distance = cv2.distanceTransform(mask, cv2.DIST_L2, 3)
    return float(np.percentile(distance[mask > 0], 90))


def _sorted_values(stack: np.ndarray) -> np.ndarray:
    """Sort each pixel's values from dark to bright, (height, width, F)."""
    # OpenCV transposes ten times as fast as NumPy.
    by_pixel = cv2.transpose(stack.reshape(len(stack), -1))
    by_pixel.sort(axis=-1, kind="stable")  # a fast radix sort
    return by_pixel.reshape(*stack.shape[1:], -1)


def _percentile(ordered: np.ndarray, percent: float) -> np.ndarray:
    """Compute a percentile of ordered values, (height, width) float32."""
    last = ordered.shape[-1] - 1
    place = percent / 100 * last
    before = min(int(place), last)
    after = min(before + 1, last)
    low = ordered[..., before].astype(np.float32)
    high = ordered[..., after].astype(np.float32)
    return low + np.float32(place - before) * (high - low)


def fill_never_uncovered(
    scene: np.ndarray, grasp: np.ndarray, length: float
) -> np.ndarray:
    """Replace pixels that the string always covers by their surroundings.

    They occur only if the grasp rests. Pixels brighter than their surroundings and
    connected with the grasp count as string.

    Parameters
    ----------
    scene : (height, width) array
        Scene without moving string and arm [grey levels].
    grasp : (F, 2) array
        Pixels of the grasp.
    length : float
        Length of the string [px].

    Returns
    -------
    (height, width) array
        The scene [grey levels].
    """
    if np.ptp(grasp, axis=0).max() > STILL_PX:
        return scene
    width = min(int(length), MAX_MEDIAN_WIDTH_PX) // 2 * 2 + 1
    levels = np.clip(scene, 0, 255).astype(np.uint8)
    surroundings = cv2.medianBlur(levels, width).astype(np.float32)
    v, u = np.indices(scene.shape)
    distance = np.hypot(u - grasp[0, 0], v - grasp[0, 1])
    bright = (scene > surroundings + SHADOW_GREY) & (distance < length)
    patch = cv2.connectedComponents(bright.astype(np.uint8))[1]
    at_grasp = np.setdiff1d(patch[distance < STATIC_SHARE * length], 0)
    is_string = np.isin(patch, at_grasp)
    return np.where(is_string, np.minimum(scene, surroundings), scene)


def expected_brightness(
    image: np.ndarray,
    scene: np.ndarray,
    arm_joints: np.ndarray,
    width: float,
    margin: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute the largest brightness of a frame without the string.

    The arm is assumed as bright as along its middle. The string in front of it must be
    brighter.

    Parameters
    ----------
    image : (height, width) array
        The frame [grey levels].
    scene : (height, width) array
        The scene behind string and arm [grey levels].
    arm_joints : (M, J + 1, 2) array
        Samples of the arm's joints during the exposure [px].
    width : float
        Width of a link [px].
    margin : float
        Error of the arm's outline [px].

    Returns
    -------
    brightest : (height, width) float32 array
        Largest brightness [grey levels].
    body : (height, width) bool array
        Pixels that show only the arm.
    outline : (height, width) bool array
        Pixels where the arm's outline makes brightness uncertain.
    """
    if not len(arm_joints):
        empty = np.zeros(scene.shape, bool)
        return scene, empty, empty
    arm_masks = [rasterise(joints, scene.shape, width) > 0 for joints in arm_joints]
    cover = cv2.GaussianBlur(np.mean(arm_masks, axis=0, dtype=np.float32), (0, 0), 0.5)
    body = cover > 0.99
    middle = (rasterise(arm_joints, scene.shape, width / 3) > 0) & body
    arm_level = float(np.median(image[middle])) if middle.any() else 0.0
    blended = scene + cover * (arm_level - scene)
    square = np.ones((2 * round(margin) + 1,) * 2, np.uint8)
    near = cv2.dilate(cover, square) > 0
    brightest = np.where(near, cv2.dilate(blended, square), blended)
    uncertain = brightest > blended + MAX_OUTLINE_ERROR_GREY
    return brightest, body, near & uncertain


def string_brightness(images: Sequence[np.ndarray], scene: np.ndarray) -> float:
    """Measure the string's brightness without blur [grey levels].

    It is that of each frame's brightest pixel relative to the scene.
    """
    brightest = []
    for number in choose_evenly(len(images), BRIGHTNESS_SAMPLES):
        image = images[number]
        brightest.append(image.flat[np.argmax(image - scene)])
    return float(np.percentile(brightest, 90))


def grey_noise(difference: np.ndarray) -> float:
    """Estimate the noise from a difference of any shape, by the median.

    The string does not affect it, because it covers less than half of the pixels.
    """
    return max(mad_sigma(difference - np.median(difference)), MIN_NOISE_GREY)


def remove_specks(mask: np.ndarray) -> np.ndarray:
    """Remove patches smaller than MIN_PATCH_PX from a mask, uint8 of 0 and 1."""
    _, label, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    is_large = stats[:, cv2.CC_STAT_AREA] >= MIN_PATCH_PX
    return mask & is_large[label].astype(np.uint8)
