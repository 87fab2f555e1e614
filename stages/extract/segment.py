"""Segmentation: the pixels of a frame that are brighter than the scene without the
string would be.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

MAX_SCENE_SAMPLES = 120  # frames from which the background is learnt
BAND_ROWS = 16  # rows of them that are put in order at a time: about a megabyte
# of the frames without the arm: where in their order of brightness the wall is not in
# shadow
LIT_QUANTILE = 0.75
SHADE_SIGMAS = 4.0  # [grey levels] by how much a shadow at least darkens the wall
# percentile over time: a pixel shows the background when the string has left it at
# least this often
MIN_LEVEL = 3
# of the string's length: how far from a resting grasp the string may never leave its
# pixels
STATIC_SHARE = 0.35
STILL_PX = 5.0  # [px] a resting grasp moves less
# [px] of the median that fills it in; OpenCV does none that is wider than 361
MAX_WINDOW_PX = 350
MIN_PATCH_PX = 12  # [px] a patch with fewer is the arm's edge or noise, not string
OUTLINE_SIGMAS = 1.0  # [px] by how much the outline of a resting arm may be off
# the string outshines nothing less than this part of the typical
MIN_CONTRAST_SIGMAS = 5.0
# [grey levels] more than this off, a pixel does not tell where the string's middle is
UNCERTAIN_SIGMAS = 10.0
GREY_SHARE = 0.3  # [grey levels] noise of rounding to whole levels


@dataclass(frozen=True)
class Backdrop:
    """The scene behind the string, shared by all frames of a film.

    scene: (height, width) grey levels without string and arm. string: brightness of the
    string [grey levels]. half: half its width, blurred [px]. sway: one sigma of where
    the camera looks [px].
    """

    scene: np.ndarray
    string: float
    half: float
    sway: float


@dataclass(frozen=True)
class SegmentedFrame:
    """The string of one frame, each array (height, width).

    light: brightness above what else is seen, as in front of the scene [grey levels].
    mask: where it is certain, uint8. arm: where the arm may hide it, outline: where the
    arm's edge blurs what is what, bool. noise: one sigma of light.
    """

    light: np.ndarray
    mask: np.ndarray
    arm: np.ndarray
    outline: np.ndarray
    noise: float


def segment_frame(
    image: np.ndarray,
    backdrop: Backdrop,
    moments: np.ndarray,
    width: float,
    blur: float,
    sigmas: float,
) -> SegmentedFrame:
    """The pixels of a frame that are neither scene nor arm.

    moments: (K, J + 1, 2) the arm's joints [px] at moments of the exposure. width: of a
    link, blur: how far the arm moves in the exposure [px]; its clock may be half an
    exposure off. sigmas: threshold above the noise.
    """
    seen, body, outline = expected_brightness(
        image, backdrop.scene, moments, width, OUTLINE_SIGMAS + blur / 2
    )
    above = cv2.GaussianBlur(image - seen, (0, 0), 0.8)
    grain = estimate_noise(above[::3, ::3])
    rough = max(grain, estimate_noise(above[body])) if body.any() else grain
    mask = remove_specks(
        (above > sigmas * np.where(body, rough, grain)).astype(np.uint8)
    )
    arm = arm_silhouette(image.shape, moments, width + 4 + blur)
    # what is as bright as the arm is noise, made larger
    sure = ~body | (cv2.dilate(mask, np.ones((5, 5), np.uint8)) > 0)
    # brightness as it would be in front of a typical part: the string outshines a
    # bright arm less than a dark wall
    room = backdrop.string - seen
    typical = max(float(np.median(room)), GREY_SHARE)
    light = (
        np.maximum(above, 0) * typical / np.maximum(room, typical / MIN_CONTRAST_SIGMAS)
    )
    return SegmentedFrame(sure * light, mask, arm, outline, grain)


def estimate_background(
    frames: Sequence[np.ndarray],
    arm: Sequence[np.ndarray],
    low: np.ndarray,
    half: float,
) -> np.ndarray:
    """The scene without string and arm, (height, width) float32.

    frames: some, (height, width) uint8 each. arm: of each the pixels where the arm is,
    `packed`. low: `darkest` of them. half: half the string's width [px]. What is bright
    in a few frames is string or arm; but where a shadow passes, the wall is what is
    bright in some, over more than the string's width.
    """
    wall = np.maximum(_map_bands(_brightness_without_arm, frames, arm) - low, 0)
    across = 2 * int(np.ceil(2 * half)) + 5
    wide = cv2.morphologyEx(wall, cv2.MORPH_OPEN, np.ones((across, across), np.uint8))
    return low + np.where(wide > SHADE_SIGMAS, wide, 0)


def uncovered_brightness(frames: Sequence[np.ndarray]) -> np.ndarray:
    """The brightness of each pixel when nothing bright covers it, (height, width)
    float32. frames: uint8.
    """
    levels = _map_bands(_low_and_median, frames)
    low, middle = levels[..., 0], levels[..., 1]
    # noise alone makes a low percentile darker than the scene
    return np.asarray(low + np.median(middle - low))


def _map_bands(
    look: Callable[..., np.ndarray], *films: Sequence[np.ndarray]
) -> np.ndarray:
    """A look at frames, so many rows of all at a time: what is made of them meanwhile
    fits into a processor's cache.

    look: from stacks (F, rows, width), one of each film, to (rows, width, ...).
    """
    bands = (
        slice(first, first + BAND_ROWS)
        for first in range(0, len(films[0][0]), BAND_ROWS)
    )
    return np.concatenate(
        [
            look(*(np.stack([frame[rows] for frame in film]) for film in films))
            for rows in bands
        ]
    )


def _low_and_median(stack: np.ndarray) -> np.ndarray:
    """A low percentile of each pixel and its median, (height, width, 2) float32."""
    ordered = _sorted_values(stack)
    return np.stack(
        [_percentile(ordered, MIN_LEVEL), _percentile(ordered, 50)], axis=-1
    )


def _brightness_without_arm(stack: np.ndarray, arm: np.ndarray) -> np.ndarray:
    """How bright a pixel is in a few of the frames in which the arm does not cover it,
    (height, width) float32.
    """
    arm = unpack_mask(arm, stack.shape[-1])
    ordered = _sorted_values(np.where(arm, 0, stack))
    covered = arm.sum(axis=0)
    place = covered + LIT_QUANTILE * (len(stack) - 1 - covered)
    chosen = np.take_along_axis(
        ordered, place.astype(int).clip(0, len(stack) - 1)[..., None], axis=-1
    )
    return chosen[..., 0].astype(np.float32)


def pack_mask(mask: np.ndarray) -> np.ndarray:
    """A mask (..., width) bool with eight pixels to a byte: masks of a whole film take
    a tenth of a gigabyte.
    """
    return np.packbits(mask, axis=-1)


def unpack_mask(mask: np.ndarray, width: int) -> np.ndarray:
    """The mask again, (..., width) bool."""
    return np.unpackbits(mask, axis=-1, count=width).view(bool)


def half_widths(
    frames: Sequence[np.ndarray], scene: np.ndarray, arm: Sequence[np.ndarray]
) -> float:
    """Half the width of what outshines the scene most [px], blurred as it may be in
    some frames: the string's.
    """
    widths = []
    for number in np.unique(
        np.linspace(0, len(frames) - 1, MAX_SCENE_SAMPLES // 8).astype(int)
    ):
        covered = unpack_mask(arm[number], scene.shape[1]).astype(np.uint8)
        above = np.where(
            cv2.dilate(covered, np.ones((5, 5))) > 0, 0, frames[number] - scene
        )
        widths.append(
            half_width(remove_specks((above > above.max() / 2).astype(np.uint8)))
        )
    return float(np.percentile(widths, 90))


def half_width(mask: np.ndarray) -> float:
    """Half the width of what is in the mask [px]: a typical distance of its inside from
    its edge.
    """
    distance = cv2.distanceTransform(mask, cv2.DIST_L2, 3)
    return float(np.percentile(distance[mask > 0], 90)) if mask.any() else 1.0


def _sorted_values(stack: np.ndarray) -> np.ndarray:
    """Each pixel's values from dark to bright, (height, width, F)."""
    # ten times as quick as NumPy's
    turned: np.ndarray = cv2.transpose(stack.reshape(len(stack), -1))
    turned.sort(axis=-1, kind="stable")  # by radix: quick
    return turned.reshape(*stack.shape[1:], -1)


def _percentile(ordered: np.ndarray, percent: float) -> np.ndarray:
    """A percentile of ordered values, (height, width) float32."""
    place = percent / 100 * (ordered.shape[-1] - 1)
    before = min(int(place), ordered.shape[-1] - 1)
    after = min(before + 1, ordered.shape[-1] - 1)
    low, high = (
        ordered[..., before].astype(np.float32),
        ordered[..., after].astype(np.float32),
    )
    return low + np.float32(place - before) * (high - low)


def fill_never_uncovered(
    scene: np.ndarray, grasp: np.ndarray, length: float
) -> np.ndarray:
    """The scene with what the string never leaves replaced by what surrounds it.

    grasp: (F, 2) [px], length: of the string [px]. Only where the grasp rests; a moving
    one uncovers everything. What outshines its surroundings and hangs together with
    what is at the grasp is taken for string.
    """
    if np.ptp(grasp, axis=0).max() > STILL_PX:
        return scene
    width = min(int(length), MAX_WINDOW_PX) // 2 * 2 + 1
    around = cv2.medianBlur(np.clip(scene, 0, 255).astype(np.uint8), width).astype(
        np.float32
    )
    v, u = np.indices(scene.shape)
    away = np.hypot(u - grasp[0, 0], v - grasp[0, 1])
    patch = cv2.connectedComponents(
        ((scene > around + SHADE_SIGMAS) & (away < length)).astype(np.uint8)
    )[1]
    hangs = np.isin(patch, np.setdiff1d(patch[away < STATIC_SHARE * length], 0))
    return np.where(hangs, np.minimum(scene, around), scene)


def expected_brightness(
    image: np.ndarray,
    scene: np.ndarray,
    moments: np.ndarray,
    width: float,
    margin: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The brightest that a frame could be without the string, (height, width) float32.

    Also, bool: where the arm is all it shows, and where the arm's outline makes it
    uncertain.

    moments: (K, J + 1, 2) the arm's joints [px] at moments of the exposure, width: of a
    link, margin: by how much its outline may be off [px]. The arm is taken to be as
    bright as along its middle; the string in front of it must be brighter.
    """
    if not len(moments):
        nowhere = np.zeros(scene.shape, bool)
        return scene, nowhere, nowhere
    covers = [arm_silhouette(scene.shape, joints[None], width) for joints in moments]
    cover = cv2.GaussianBlur(np.mean(covers, axis=0, dtype=np.float32), (0, 0), 0.5)
    middle = arm_silhouette(scene.shape, moments, max(width / 3, 1)) & (cover > 0.99)
    body = float(np.median(image[middle])) if middle.any() else 0.0
    seen = scene + cover * (body - scene)
    around = np.ones((2 * round(margin) + 1,) * 2, np.uint8)
    near = cv2.dilate(cover, around) > 0
    most = np.where(near, cv2.dilate(seen, around), seen)
    return most, cover > 0.99, near & (most > seen + UNCERTAIN_SIGMAS)


def string_brightness(images: Sequence[np.ndarray], scene: np.ndarray) -> float:
    """The brightness of the string where nothing blurs it, from where each frame
    outshines the scene most.
    """
    chosen = np.unique(
        np.linspace(0, len(images) - 1, MAX_SCENE_SAMPLES // 4).astype(int)
    )
    return float(
        np.percentile(
            [images[int(i)].flat[np.argmax(images[int(i)] - scene)] for i in chosen], 90
        )
    )


def estimate_noise(difference: np.ndarray) -> float:
    """One sigma of what is not string, by the median: the string covers less than half.
    difference: any shape.
    """
    return max(
        float(np.median(np.abs(difference - np.median(difference)))) / 0.6745,
        GREY_SHARE,
    )


def remove_specks(mask: np.ndarray) -> np.ndarray:
    """The mask without patches of fewer than SPECK pixels. mask: (height, width) uint8,
    0 or 1.
    """
    _, label, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    return mask & (stats[:, cv2.CC_STAT_AREA] >= MIN_PATCH_PX)[label].astype(np.uint8)


def arm_silhouette(
    shape: tuple[int, ...], moments: np.ndarray, width: float
) -> np.ndarray:
    """Pixels within `width` / 2 [px] of the arm's links at any moment, bool. moments:
    (K, J + 1, 2) joints [px].
    """
    canvas = np.zeros(shape, np.uint8)
    pixels = list(np.rint(moments * 16).astype(np.int32)[:, :, None])
    cv2.polylines(canvas, pixels, False, 255, max(round(width), 1), cv2.LINE_8, 4)
    return canvas > 0
