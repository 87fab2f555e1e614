"""Stabilisation: frames corrected for a flickering lamp and a trembling camera.

Each frame is compared with the median of the film: frame = gain * median, shifted (d_u,
d_v), by least squares on the picture's own texture (Lucas and Kanade, IJCAI 1981),
where what moves has no weight. Where there is too little texture, nothing is changed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from stringcast.stages.common import mad_sigma

MAX_SAMPLES = 120  # frames whose median stands for the film
# the picture is made so many times smaller: large shifts first, then their fractions
PYRAMID_SCALES = (8, 3)
NEWTON_STEPS = 2  # of Gauss and Newton in each
MIN_GAIN = 1e-3  # gain of a black frame
MAX_SHIFT_PX = 3.0  # sigmas from which a pixel shows something that moves
MIN_TREMBLE_PX = 0.1  # [px] RMS shift below which a camera stands still
MIN_FLICKER = 0.01  # RMS relative brightness below which a lamp burns steadily
# of both, below which the first look is enough: it errs by 0.05 px, and so finds the
# more, not the less
CLEAR_SHARE = 0.7
# [px] one sigma of a shift, above which there is too little texture to know it
SURE_SHARE = 0.05
# across and down: what one of them alone says, such as a wide string that swings there,
# is not believed
IMAGE_PARTS = 5


def sample_numbers(count: int) -> list[int]:
    """SAMPLES of so many frames at most, evenly."""
    return [
        int(i) for i in np.unique(np.linspace(0, count - 1, MAX_SAMPLES).astype(int))
    ]


def stabilise_film(images: Sequence[np.ndarray]) -> tuple[Sequence[np.ndarray], float]:
    """The film without flicker and tremble (the same object where it has none), and one
    sigma of the mean shift [px].
    """
    coarse, fine = PYRAMID_SCALES
    found, _ = _register_images(
        images, coarse, np.tile([1.0, 0.0, 0.0], (len(images), 1))
    )
    gain, shift = _significant_changes(found, CLEAR_SHARE)
    if shift.any() or (gain != 1).any():
        found, sigma = _register_images(images, fine, found)
        found[sigma >= SURE_SHARE, 1:] = 0.0
        gain, shift = _significant_changes(found, 1.0)
    if not shift.any() and (gain == 1).all():
        return images, 0.0
    middle = np.sqrt(np.pi / 2 / len(shift))  # of a median, in sigmas of its values
    return StabilisedImages(images, gain, shift), float(
        middle * np.sqrt(np.mean(shift**2))
    )


@dataclass(frozen=True)
class StabilisedImages(Sequence[np.ndarray]):
    """Images divided by gain (F,) and shifted back by shift (F, 2) [px], float32."""

    images: Sequence[np.ndarray] = field(repr=False)
    gain: np.ndarray
    shift: np.ndarray

    def __len__(self) -> int:
        """Number of images."""
        return len(self.images)

    def __getitem__(self, index):  # type: ignore[no-untyped-def]
        """One image."""
        image = self.images[index].astype(np.float32) / np.float32(
            max(self.gain[index], MIN_GAIN)
        )
        return (
            _shift_image(image, -self.shift[index])
            if self.shift[index].any()
            else image
        )


def _significant_changes(
    found: np.ndarray, share: float
) -> tuple[np.ndarray, np.ndarray]:
    """Gains (F,) and shifts (F, 2) [px] about their medians; 1 and 0 where they are
    within a share of what counts.
    """
    gain, shift = (
        found[:, 0] / np.median(found[:, 0]),
        found[:, 1:] - np.median(found[:, 1:], axis=0),
    )
    shift = (
        shift
        if np.sqrt(np.mean(shift**2)) > share * MIN_TREMBLE_PX
        else np.zeros_like(shift)
    )
    gain = (
        gain
        if np.sqrt(np.mean((gain - 1) ** 2)) > share * MIN_FLICKER
        else np.ones_like(gain)
    )
    return gain, shift


def _downscale(image: np.ndarray, by: int) -> np.ndarray:
    """The image so many times smaller, float32."""
    small = cv2.resize(
        image.astype(np.float32),
        None,
        fx=1 / by,
        fy=1 / by,
        interpolation=cv2.INTER_AREA,
    )
    return cv2.GaussianBlur(small, (0, 0), 1.0)


def _register_images(
    images: Sequence[np.ndarray], by: int, start: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Gain and shift (d_u, d_v) [px] of each image against the median of some, all so
    many times smaller, (F, 3), and one sigma of the shift (F,) [px], by Gauss and
    Newton. start: (F, 3) from where.
    """
    template = np.median(
        [_downscale(images[i], by) for i in sample_numbers(len(images))], axis=0
    )
    places, sigmas = [], []
    for whole, begin in zip(images, start, strict=True):
        image, found = _downscale(whole, by), begin
        for _ in range(NEWTON_STEPS):
            like = _shift_image(template, found[1:] / by)
            across = cv2.Sobel(like, cv2.CV_32F, 1, 0, scale=0.125)
            down = cv2.Sobel(like, cv2.CV_32F, 0, 1, scale=0.125)
            columns = np.stack([like, -found[0] * across / by, -found[0] * down / by])[
                :, 2:-2, 2:-2
            ]
            rest = (image - found[0] * like)[2:-2, 2:-2]
            still = np.abs(rest) < MAX_SHIFT_PX * (
                float(mad_sigma(rest.ravel()[::7])) + 1e-3
            )
            # normal equations of each part of the picture, (PARTS^2, 4, 4), and steps
            # without each in turn
            bands = np.array_split(
                np.concatenate([columns, rest[None]]) * still, IMAGE_PARTS, axis=1
            )
            parts = [
                part.reshape(4, -1)
                for band in bands
                for part in np.array_split(band, IMAGE_PARTS, axis=2)
            ]
            sums = np.stack([part @ part.T for part in parts])
            others = sums.sum(axis=0) - sums
            steps = np.linalg.solve(
                others[:, :3, :3] + 1e-6 * np.eye(3), others[:, :3, 3:]
            )[..., 0]
            found = found + np.mean(steps, axis=0)
        scatter = np.sqrt((len(steps) - 1) * np.var(steps, axis=0))  # the jackknife
        places.append(found)
        sigmas.append(float(np.linalg.norm(scatter[1:])))
    return np.array(places), np.array(sigmas)


def _shift_image(image: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """The image shifted by (d_u, d_v) [px]."""
    to = np.array([[1, 0, shift[0]], [0, 1, shift[1]]])
    return cv2.warpAffine(
        image,
        to,
        image.shape[::-1],
        flags=cv2.INTER_LANCZOS4,
        borderMode=cv2.BORDER_REPLICATE,
    )
