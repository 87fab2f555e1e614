"""Stabilisation: correction of frames for a flickering lamp and a shaking camera.

Each frame is modelled as gain * median of the film, shifted by (d_u, d_v). Least
squares on the picture's texture finds gain and shift; moving pixels have no weight.
Without enough texture nothing is changed.

Reference: B. Lucas and T. Kanade, An iterative image registration technique with an
application to stereo vision, IJCAI 1981.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stringcast.data.lazy_module import LazyModule
from stringcast.stages.common import choose_evenly, mad_sigma, rms

cv2 = LazyModule("cv2")

MAX_SAMPLES = 120  # frames for the median
# Factors of reduction of the picture, for large shifts and then for their fractions.
COARSE_SCALE = 8
FINE_SCALE = 3
NEWTON_STEPS = 2  # Gauss-Newton steps at each scale
MIN_GAIN = 1e-3  # of a black frame
MOVING_PIXEL_SIGMAS = 3.0  # residual of a moving pixel
MIN_SHAKE_PX = 0.1  # RMS shift below which the camera is still
MIN_FLICKER = 0.01  # RMS relative brightness below which the lamp is steady
# Share of both thresholds at the coarse scale, which has an error of 0.05 px. It adds
# candidates and loses none.
COARSE_THRESHOLD_SHARE = 0.7
MAX_SHIFT_SIGMA_PX = 0.05  # above it there is too little texture
# Parts across and down. A shift in one part only, such as of a wide string that swings
# there, is rejected.
IMAGE_PARTS = 5


def stabilise_film(images: Sequence[np.ndarray]) -> tuple[Sequence[np.ndarray], float]:
    """Remove flicker and shake from a film.

    Parameters
    ----------
    images : sequence of F arrays (height, width)
        The film [grey levels].

    Returns
    -------
    images : sequence of F arrays (height, width)
        The corrected film, or the same object if it needs no correction.
    sigma : float
        Standard deviation of the mean shift [px].
    """
    unchanged = np.tile([1.0, 0.0, 0.0], (len(images), 1))
    registration, _ = _register_images(images, COARSE_SCALE, unchanged)
    gain, shift = _significant_changes(registration, COARSE_THRESHOLD_SHARE)
    if shift.any() or (gain != 1).any():
        registration, sigma = _register_images(images, FINE_SCALE, registration)
        registration[sigma >= MAX_SHIFT_SIGMA_PX, 1:] = 0.0
        gain, shift = _significant_changes(registration, 1.0)
    if not shift.any() and (gain == 1).all():
        return images, 0.0
    median_sigma = np.sqrt(
        np.pi / 2 / len(shift)
    )  # of the median, in sigmas of a value
    sway = float(median_sigma * rms(shift))
    return StabilisedImages(images, gain, shift), sway


@dataclass(frozen=True)
class StabilisedImages(Sequence[np.ndarray]):
    """Images divided by gain (F,) and shifted back by shift (F, 2) [px], float32."""

    images: Sequence[np.ndarray] = field(repr=False)
    gain: np.ndarray
    shift: np.ndarray

    def __len__(self) -> int:
        """Count the images."""
        return len(self.images)

    def __getitem__(self, index: Any) -> Any:
        """Correct one image."""
        gain = np.float32(max(self.gain[index], MIN_GAIN))
        image = self.images[index].astype(np.float32) / gain
        if self.shift[index].any():
            return _shift_image(image, -self.shift[index])
        return image


def _significant_changes(
    registration: np.ndarray, threshold_share: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return significant gains (F,) and shifts (F, 2) [px] about their medians.

    If their RMS is below this share of the threshold, gains are 1, or shifts 0.
    """
    gain = registration[:, 0] / np.median(registration[:, 0])
    if not rms(gain - 1) > threshold_share * MIN_FLICKER:
        gain = np.ones_like(gain)
    shift = registration[:, 1:] - np.median(registration[:, 1:], axis=0)
    if not rms(shift) > threshold_share * MIN_SHAKE_PX:
        shift = np.zeros_like(shift)
    return gain, shift


def _downscale(image: np.ndarray, scale: int) -> np.ndarray:
    """Reduce an image by the factor `scale` and smooth it, float32."""
    small = cv2.resize(
        image.astype(np.float32),
        None,
        fx=1 / scale,
        fy=1 / scale,
        interpolation=cv2.INTER_AREA,
    )
    return cv2.GaussianBlur(small, (0, 0), 1.0)


def _register_images(
    images: Sequence[np.ndarray], scale: int, start: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Register each image to the film's median, both reduced by the factor `scale`.

    start: initial gains and shifts (d_u, d_v) [px] of Gauss-Newton, (F, 3). Returns
    gains and shifts (F, 3), and the standard deviation of the shifts (F,) [px].
    """
    numbers = choose_evenly(len(images), MAX_SAMPLES)
    samples = [_downscale(images[number], scale) for number in numbers]
    template = np.median(samples, axis=0)
    registration, sigmas = [], []
    for full_image, first_guess in zip(images, start, strict=True):
        image = _downscale(full_image, scale)
        guess = first_guess
        for _ in range(NEWTON_STEPS):
            steps = _newton_steps(image, template, guess, scale)
            guess = guess + np.mean(steps, axis=0)
        # Jackknife over the parts of the picture.
        scatter = np.sqrt((len(steps) - 1) * np.var(steps, axis=0))
        registration.append(guess)
        sigmas.append(float(np.linalg.norm(scatter[1:])))
    return np.array(registration), np.array(sigmas)


def _newton_steps(
    image: np.ndarray, template: np.ndarray, guess: np.ndarray, scale: int
) -> np.ndarray:
    """Compute Gauss-Newton steps that omit each part in turn, (IMAGE_PARTS^2, 3)."""
    gain = guess[0]
    shifted = _shift_image(template, guess[1:] / scale)
    slope_u = cv2.Sobel(shifted, cv2.CV_32F, 1, 0, scale=0.125)
    slope_v = cv2.Sobel(shifted, cv2.CV_32F, 0, 1, scale=0.125)
    slopes = np.stack([shifted, -gain * slope_u / scale, -gain * slope_v / scale])
    residual = (image - gain * shifted)[2:-2, 2:-2]
    noise = mad_sigma(residual.ravel()[::7]) + 1e-3
    is_still = np.abs(residual) < MOVING_PIXEL_SIGMAS * noise

    # Normal equations of each part, (IMAGE_PARTS^2, 4, 4): three slopes and the
    # residual.
    system = np.concatenate([slopes[:, 2:-2, 2:-2], residual[None]]) * is_still
    products = []
    for band in np.array_split(system, IMAGE_PARTS, axis=1):
        for part in np.array_split(band, IMAGE_PARTS, axis=2):
            rows = part.reshape(4, -1)
            products.append(rows @ rows.T)
    sums = np.stack(products)
    without = sums.sum(axis=0) - sums
    matrix = without[:, :3, :3] + 1e-6 * np.eye(3)
    return np.linalg.solve(matrix, without[:, :3, 3:])[..., 0]


def _shift_image(image: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Shift an image by (d_u, d_v) [px]."""
    return cv2.warpAffine(
        image,
        np.array([[1, 0, shift[0]], [0, 1, shift[1]]]),
        image.shape[::-1],
        flags=cv2.INTER_LANCZOS4,
        borderMode=cv2.BORDER_REPLICATE,
    )
