"""Position of the arm in the frames, if its reported joint angles are wrong.

Wrong joint angles, a moved camera or a wrong clock displace the arm in the picture. If
the displacement exceeds the arm's width, the arm itself is taken for string, and frames
are refused. Here the links are fitted to bright pixels of regions as wide as a link, by
least squares (iterative closest point, ICP). Over the whole film each joint may have an
offset, a gain and a lag, and the base a shift.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stringcast.data.lazy_module import LazyModule
from stringcast.stages.common import choose_evenly
from stringcast.stages.extract.footage import Footage
from stringcast.stages.extract.segment import OUTLINE_ERROR_PX, grey_noise
from stringcast.stages.model.camera import Camera
from stringcast.stages.model.polyline import turn_left

cv2 = LazyModule("cv2")

SAMPLE_FRAMES = 40  # for the fit of the links
OPENING_SHARE = 0.6  # of a link's width: narrower bright regions are string
MIN_CONTRAST_SIGMAS = 10.0  # of the arm to the wall, in noise
MAX_PIXELS = 300  # of the arm in one frame
MIN_PIXELS = 2000  # of the arm in all frames; with fewer it is not visible
# Largest distance of a pixel from the links, in link widths, for each iteration.
CUTOFFS_WIDTHS = (8.0, 8.0, 4.0, 4.0, 2.0, 2.0, 1.0, 1.0, 1.0, 1.0)
# Prior standard deviations of the parameters.
OFFSET_SIGMA_RAD = 0.1
GAIN_SIGMA = 0.1
LAG_SIGMA_S = 0.01
BASE_SIGMA_M = 0.02
MAX_MISSED_SHARE = 0.1  # of the arm's pixels, outside the fitted links
MIN_MISSED_SHARE = 0.02  # outside the reported links; below it these are right
MAX_MISSED_RATIO = 0.5  # of pixels outside the fitted links to outside the reported
MIN_HAND_SHIFT_PX = 2.0  # a smaller shift is within the error of the outline


@dataclass(frozen=True)
class ArmFit:
    """The arm in the frames of a film.

    Parameters
    ----------
    body : (F, J + 1, 2) fitted joints [m]
    hand_shift : (F,) distance of the hand from its reported position [m]
    joint_error : (F,) largest difference of a joint's angle from the reported [rad]
    """

    body: np.ndarray
    hand_shift: np.ndarray
    joint_error: np.ndarray


@dataclass(frozen=True)
class ReportedArm:
    """The reported arm, and its slopes with the parameters of the fit.

    The parameters (3 J + 2,) are offset [rad], gain [1] and lag [s] of each joint, then
    the shift of the base in x and y [m]. At zero the arm is as reported.

    Parameters
    ----------
    body : (F, J + 1, 2) joints [m]
    angle_slopes : (F, J, 3) slope of each joint's angle with its offset, gain and lag
    """

    body: np.ndarray
    angle_slopes: np.ndarray

    @classmethod
    def build(cls, t: np.ndarray, body: np.ndarray) -> ReportedArm:
        """Build the arm from joints (F, J + 1, 2) [m] at times (F,) [s]."""
        links = np.diff(body, axis=1)
        directions = np.unwrap(np.arctan2(links[..., 1], links[..., 0]), axis=0)
        angles = np.diff(directions, axis=1, prepend=0)
        speeds = np.gradient(angles, t, axis=0)
        slopes = np.stack([np.ones_like(angles), angles - angles[0], speeds], axis=-1)
        return cls(body, slopes)

    @property
    def prior_sigmas(self) -> np.ndarray:
        """Prior standard deviations of the parameters, (3 J + 2,)."""
        of_joint = [OFFSET_SIGMA_RAD, GAIN_SIGMA, LAG_SIGMA_S]
        joints = self.angle_slopes.shape[1]
        return np.array([*np.tile(of_joint, joints), BASE_SIGMA_M, BASE_SIGMA_M])

    def angle_errors(self, parameters: np.ndarray) -> np.ndarray:
        """Compute actual minus reported joint angles, (F, J) [rad]."""
        by_joint = parameters[:-2].reshape(-1, 3)
        return np.einsum("fjk,jk->fj", self.angle_slopes, by_joint)

    def joint_positions(self, parameters: np.ndarray) -> np.ndarray:
        """Compute the positions of the joints, (F, J + 1, 2) [m]."""
        # A joint turns all links beyond it.
        angle = np.cumsum(self.angle_errors(parameters), axis=1)[..., None]
        links = np.diff(self.body, axis=1)
        turned = np.cos(angle) * links + np.sin(angle) * turn_left(links)
        base = self.body[:, :1] + parameters[-2:]
        return np.concatenate([base, base + np.cumsum(turned, axis=1)], axis=1)


def fit_arm(
    footage: Footage, camera: Camera, uncovered: np.ndarray, width_px: float
) -> ArmFit | None:
    """Find the arm in the frames.

    Parameters
    ----------
    footage : Footage
        Stabilised frames, with the reported arm.
    camera : Camera
        Its geometry.
    uncovered : (height, width) array
        Brightness without string and arm [grey levels].
    width_px : float
        Width of a link [px].

    Returns
    -------
    ArmFit or None
        None if the reported arm is right, or if the arm is not clearly visible.
    """
    if footage.body is None or width_px < 1:
        return None
    arm = ReportedArm.build(footage.t, footage.body)
    pixels = bright_wide_pixels(footage.images, uncovered, width_px)
    frame = np.concatenate([np.full(len(p), f) for f, p in pixels.items()])
    place = camera.world(np.concatenate(list(pixels.values())))
    if len(place) < MIN_PIXELS:
        return None

    width_m = width_px / camera.px_per_m
    parameters = _fit_parameters(arm, frame, place, width_m)
    body = arm.joint_positions(parameters)
    hand_shift = np.linalg.norm(body[:, -1] - footage.body[:, -1], axis=-1)

    reach = width_m / 2 + OUTLINE_ERROR_PX / camera.px_per_m
    as_reported = np.zeros_like(parameters)
    missed_before = _share_beyond(reach, arm, as_reported, frame, place)
    missed = _share_beyond(reach, arm, parameters, frame, place)
    is_seen = missed <= min(MAX_MISSED_SHARE, MAX_MISSED_RATIO * missed_before)
    shift_px = hand_shift.max() * camera.px_per_m
    is_elsewhere = missed_before >= MIN_MISSED_SHARE and shift_px >= MIN_HAND_SHIFT_PX
    if not (is_seen and is_elsewhere):
        return None
    joint_error = np.abs(arm.angle_errors(parameters)).max(axis=1)
    return ArmFit(body, hand_shift, joint_error)


def _fit_parameters(
    arm: ReportedArm, frame: np.ndarray, place: np.ndarray, width_m: float
) -> np.ndarray:
    """Fit the parameters of an arm (3 J + 2,) to its pixels, (N, 2) [m].

    It takes Gauss-Newton steps with a prior on the parameters. Distances are in link
    widths. Pixels beyond a decreasing cutoff are ignored, because they are not of the
    arm.
    """
    precision = np.diag(arm.prior_sigmas**-2.0)
    parameters = np.zeros(len(precision))
    for cutoff in CUTOFFS_WIDTHS:
        distance, jacobian = _link_distances(arm, parameters, frame, place)
        is_near = np.abs(distance) < cutoff * width_m
        slopes = jacobian[is_near] / width_m
        residual = distance[is_near] / width_m
        curvature = slopes.T @ slopes + precision
        gradient = slopes.T @ residual + precision @ parameters
        parameters = parameters - np.linalg.solve(curvature, gradient)
    return parameters


def bright_wide_pixels(
    images: Sequence[np.ndarray], uncovered: np.ndarray, width_px: float
) -> dict[int, np.ndarray]:
    """Find pixels (N, 2) of bright regions as wide as a link, by frame number."""
    size = max(round(OPENING_SHARE * width_px), 2)
    link = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    pixels = {}
    for number in choose_evenly(len(images), SAMPLE_FRAMES):
        above = images[number] - uncovered
        threshold = MIN_CONTRAST_SIGMAS * grey_noise(above[::3, ::3])
        bright = (above > threshold).astype(np.uint8)
        rows, columns = np.nonzero(cv2.morphologyEx(bright, cv2.MORPH_OPEN, link))
        step = max(len(rows) // MAX_PIXELS, 1)
        places = np.stack([columns, rows], axis=-1)[::step]
        pixels[number] = places.astype(float)
    return pixels


def _share_beyond(
    reach: float,
    arm: ReportedArm,
    parameters: np.ndarray,
    frame: np.ndarray,
    place: np.ndarray,
) -> float:
    """Compute the share of pixels (N, 2) farther from the links than `reach` [m]."""
    distance, _ = _link_distances(arm, parameters, frame, place)
    return float(np.mean(np.abs(distance) > reach))


def _link_distances(
    arm: ReportedArm, parameters: np.ndarray, frame: np.ndarray, place: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Compute signed distances of pixels from the nearest link, and their Jacobian.

    Parameters
    ----------
    arm : ReportedArm
    parameters : numpy.ndarray, shape (P,)
        Parameters of the arm.
    frame : numpy.ndarray, shape (N,)
        Number of the frame of each pixel.
    place : numpy.ndarray, shape (N, 2)
        Pixels in the plane [m].

    Returns
    -------
    distance : numpy.ndarray, shape (N,)
        Distance across the link; positive beyond its ends [m].
    jacobian : numpy.ndarray, shape (N, P)
        Derivatives of the distances with respect to the parameters.
    """
    body = arm.joint_positions(parameters)[frame]  # (N, J + 1, 2)
    nearest, foot, normal = _nearest_feet(body, place)
    distance = np.sum(normal * (place - foot), axis=-1)

    # A joint turns all links beyond it; the base moves all.
    joints = arm.angle_slopes.shape[1]
    turning = np.zeros((len(place), joints))  # derivative of a distance by an angle
    for joint in range(joints):
        lever = turn_left(foot - body[:, joint])
        slope = np.where(nearest >= joint, np.sum(normal * lever, axis=-1), 0.0)
        turning[:, joint] = -slope
    by_joint = turning[..., None] * arm.angle_slopes[frame]
    jacobian = np.concatenate([by_joint.reshape(len(place), -1), -normal], axis=1)
    return distance, jacobian


def _nearest_feet(
    body: np.ndarray, place: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find the nearest point of the links to each pixel.

    Parameters
    ----------
    body : numpy.ndarray, shape (N, J + 1, 2)
        Joints in each pixel's frame [m].
    place : numpy.ndarray, shape (N, 2)
        Pixels in the plane [m].

    Returns
    -------
    nearest : numpy.ndarray, shape (N,)
        Number of the link.
    foot : numpy.ndarray, shape (N, 2)
        Nearest point on the link [m].
    normal : numpy.ndarray, shape (N, 2)
        Unit vector across the link, or from its end to the pixel.
    """
    start = body[:, :-1]
    link = np.diff(body, axis=1)
    length = np.linalg.norm(link, axis=-1)
    along = np.sum((place[:, None] - start) * link, axis=-1)
    share = np.clip(along / length**2, 0, 1)
    feet = start + share[..., None] * link  # (N, J, 2)
    distances = np.linalg.norm(place[:, None] - feet, axis=-1)
    nearest = np.argmin(distances, axis=1)

    chosen = np.arange(len(place)), nearest
    foot, share, distance = feet[chosen], share[chosen], distances[chosen]
    normal = turn_left(link[chosen]) / length[chosen][:, None]
    is_end = (share == 0) | (share == 1)
    is_end &= distance > 0
    beyond = place[is_end] - foot[is_end]
    normal[is_end] = beyond / distance[is_end, None]
    return nearest, foot, normal
