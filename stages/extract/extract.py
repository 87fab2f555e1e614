"""Extract the string from every frame of a film, with a reason if that fails."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import pandas as pd
from pydantic import Field, NonNegativeFloat, PositiveFloat

from stringcast.data.artifacts import MASKS, POINTS, READINGS, Film, Points, Trial
from stringcast.data.images import CachedImages
from stringcast.data.lazy_module import LazyModule
from stringcast.data.schema import DataError
from stringcast.stages.common import Progress, choose_evenly
from stringcast.stages.extract.arm_in_image import (
    MIN_HAND_SHIFT_PX,
    ArmFit,
    fit_arm,
)
from stringcast.stages.extract.centreline import (
    MIN_PROFILE_REACH_PX,
    Centreline,
    UnreadableError,
    cumulative_length,
    refine_line,
    trace_line,
)
from stringcast.stages.extract.footage import Footage, aligned_footage
from stringcast.stages.extract.quality import check_line
from stringcast.stages.extract.score import rasterise
from stringcast.stages.extract.segment import (
    Backdrop,
    estimate_background,
    fill_never_uncovered,
    mask_half_width,
    pack_mask,
    segment_frame,
    string_brightness,
    typical_half_width,
    uncovered_brightness,
)
from stringcast.stages.extract.stabilise import MAX_SAMPLES, stabilise_film
from stringcast.stages.extract.window import window_around
from stringcast.stages.model.camera import Camera
from stringcast.stages.model.interpolation import interpolate_rows
from stringcast.stages.spec import StageCall

cv2 = LazyModule("cv2")

WINDOW_MARGIN_PX = 12.0  # around the string's reach
MAX_EXTRA_HALF_WIDTH_PX = 2.0  # of the string in one frame over that in the film
# From this half width on, brightness has no sharp maximum in the middle.
WIDE_STRING_HALF_WIDTH_PX = 3.0
HAND_SIGMA_PX = 0.5  # of a coordinate of the hand, if fitted to the frames
# Of a reported hand: a shift is not noticed up to MIN_HAND_SHIFT_PX
REPORTED_HAND_SIGMA_PX = MIN_HAND_SHIFT_PX / np.sqrt(3)
TRACE_START_MARGIN_PX = 8.0  # of the beginning of a line beyond the hidden length


@dataclass(frozen=True)
class FrameReading:
    """The string of one frame.

    Parameters
    ----------
    points : (K, 2) positions at equal arc lengths [m]
    sigma : (K,) standard deviation of a coordinate [m]
    mask : the string's pixels as PNG
    length : length of the line [m]
    """

    points: np.ndarray
    sigma: np.ndarray
    mask: bytes
    length: float


def run(call: StageCall, trial: Trial | Film) -> Points:
    """Extract the string in each frame of a trial or film, as a stage."""
    film = trial if isinstance(trial, Film) else trial.film
    model = call.setup.model
    return call.by(aligned_footage(film, model), model.camera, progress=call.progress)


def extract(
    footage: Footage,
    camera: Camera,
    *,
    string_length: PositiveFloat,
    points: Annotated[int, Field(ge=2)],
    sigmas: PositiveFloat,
    arm_width: NonNegativeFloat,
    hidden: NonNegativeFloat,
    shorter: Annotated[float, Field(gt=0, lt=1)],
    longer: PositiveFloat,
    progress: Progress = lambda share: None,
) -> Points:
    """Extract the string's centre-line, tip and mask from each frame.

    Parameters
    ----------
    footage : Footage
        Frames, with the pose of the grasp and the arm's joints in each.
    camera : Camera
        Geometry of the camera.
    string_length : float
        Length from grasp to tip [m].
    points : int
        Number of points K reported along the string.
    sigmas : float
        Threshold in standard deviations of the noise.
    arm_width : float
        Width of the arm's links in the picture [m].
    hidden : float
        Length near the grasp that may be hidden [m].
    shorter, longer : float
        Largest relative deviations of the line's length from the string's. A swung
        string stretches.
    progress : callable
        Called with the share of frames done.

    Returns
    -------
    Points
        K points of each readable frame [m], one reading of each frame, and masks.

    Raises
    ------
    DataError
        If the size of the frames is not the camera's.
    """
    rows, columns = footage.images[0].shape
    if (columns, rows) != (camera.width, camera.height):
        raise DataError(
            "",
            f"camera.width x camera.height is {camera.width} x {camera.height}, "
            f"but the frames are {columns} x {rows} px",
            "Correct it in the dataset's dataset.yaml, or in conf/camera.",
        )
    images, sway = stabilise_film(CachedImages(footage.images))
    footage = replace(footage, images=images)
    arm_width_px = arm_width * camera.px_per_m
    frames = _sample_frames(images)
    uncovered = uncovered_brightness(frames)
    arm_fit = fit_arm(footage, camera, uncovered, arm_width_px)
    hand_sigma = 0.0  # the pose of the grasp was measured
    if arm_fit is not None:
        footage = footage.with_body(arm_fit.body)
        hand_sigma = HAND_SIGMA_PX
    elif footage.body is not None:
        hand_sigma = REPORTED_HAND_SIGMA_PX
    length_px = string_length * camera.px_per_m
    scene, half_width = _estimate_scene(
        frames, uncovered, footage, camera, arm_width_px, length_px
    )
    reader = FrameReader(
        footage,
        camera,
        Backdrop(scene, string_brightness(images, scene), half_width, sway),
        arc_lengths=np.linspace(0, string_length, points),
        sigmas=sigmas,
        arm_width=arm_width_px,
        hidden=hidden * camera.px_per_m,
        shorter=shorter,
        longer=longer,
        hand_sigma=hand_sigma,
    )
    readings: list[FrameReading | str] = []
    for number in range(len(footage.t)):
        try:
            readings.append(reader.read(number))
        except UnreadableError as reason:
            readings.append(str(reason))
        progress((number + 1) / len(footage.t))
    return _build_tables(footage.t, readings, reader.arc_lengths, arm_fit)


def _sample_frames(images: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Choose frames for the estimate of the scene, uint8."""
    frames = []
    for number in choose_evenly(len(images), MAX_SAMPLES):
        image = images[number]
        if image.dtype != np.uint8:
            image = cv2.convertScaleAbs(image)
        frames.append(image)
    return frames


def _estimate_scene(
    frames: Sequence[np.ndarray],
    uncovered: np.ndarray,
    footage: Footage,
    camera: Camera,
    arm_width: float,
    string_length: float,
) -> tuple[np.ndarray, float]:
    """Estimate the scene that all frames share, and half the string's width [px].

    frames: result of `_sample_frames`. uncovered: result of `uncovered_brightness`.
    arm_width, string_length: [px].
    """
    arms = []
    for number in choose_evenly(len(footage.images), MAX_SAMPLES):
        joints = np.zeros((0, 2, 2))
        if footage.body is not None:
            joints = camera.pixels(footage.body[number])
        arms.append(pack_mask(rasterise(joints, uncovered.shape, arm_width)))
    half_width = typical_half_width(frames, uncovered, arms)
    scene = fill_never_uncovered(
        estimate_background(frames, arms, uncovered, half_width),
        camera.pixels(footage.grasp[:, :2]),
        string_length,
    )
    return scene, half_width


@dataclass(frozen=True)
class FrameReader:
    """A reader of single frames of one film.

    Parameters
    ----------
    footage : stabilised frames with grasp and arm
    camera : geometry of the camera
    backdrop : the scene behind the string
    arc_lengths : (K,) of the points to report [m]; the last is the string's length
    sigmas : threshold in standard deviations of the noise
    arm_width : width of the arm's links [px]
    hidden : length near the grasp that may be hidden [px]
    shorter, longer : largest relative deviations from the string's length
    hand_sigma : standard deviation of a coordinate of the grasp [px]
    """

    footage: Footage
    camera: Camera
    backdrop: Backdrop
    arc_lengths: np.ndarray
    sigmas: float
    arm_width: float
    hidden: float
    shorter: float
    longer: float
    hand_sigma: float

    def read(self, number: int) -> FrameReading:
        """Read one frame; raise UnreadableError with the reason if that fails."""
        line, mask = self._find_line(number)
        world = self.camera.world(line.points)
        depth = cumulative_length(world)
        length = float(depth[-1])
        string_length = self.arc_lengths[-1]
        if length < string_length * (1 - self.shorter):
            raise UnreadableError("the line is shorter than the string")
        if length > string_length * (1 + self.longer):
            raise UnreadableError("the line is longer than the string")
        u, v = line.points[-1]
        in_columns = 1 <= u <= self.camera.width - 2
        if not (in_columns and 1 <= v <= self.camera.height - 2):
            raise UnreadableError("the string leaves the picture")

        # A line shows how much the string is stretched, but not where
        evenly_spaced = length * self.arc_lengths / string_length
        points = interpolate_rows(evenly_spaced, depth, world)
        sigma = np.interp(evenly_spaced, depth, line.sigma) / self.camera.px_per_m
        _, png = cv2.imencode(".png", mask * 255, [cv2.IMWRITE_PNG_BILEVEL, 1])
        return FrameReading(points, sigma, png.tobytes(), length)

    def _find_line(self, number: int) -> tuple[Centreline, np.ndarray]:
        """Find the centre-line [px] from the grasp on, and the string's pixels."""
        grasp = self.camera.pixels(self.footage.grasp[number, :2])
        image = self.footage.images[number]
        longest = self.arc_lengths[-1] * (1 + self.longer) * self.camera.px_per_m
        window = window_around(grasp, longest + WINDOW_MARGIN_PX, image.shape)
        if window.size.min() < 2 * MIN_PROFILE_REACH_PX:
            raise UnreadableError("the grasp is out of view")

        arm_joints, blur = self._arm_during_exposure(number)
        frame = segment_frame(
            window.cut(image),
            replace(self.backdrop, scene=window.cut(self.backdrop.scene)),
            arm_joints - window.corner,
            self.arm_width,
            blur,
            self.sigmas,
        )
        half_width = min(
            mask_half_width(frame.mask),
            self.backdrop.half_width + MAX_EXTRA_HALF_WIDTH_PX,
        )
        ridge = frame.light
        if half_width > WIDE_STRING_HALF_WIDTH_PX:
            ridge = cv2.GaussianBlur(ridge, (0, 0), 0.6 * half_width)
        path = trace_line(
            ridge,
            frame.mask,
            frame.arm,
            grasp - window.corner,
            start_radius=self.hidden + TRACE_START_MARGIN_PX,
        )
        line = refine_line(frame, path, half_width)
        check_line(line, frame.mask, half_width)

        points = np.concatenate([grasp[None], line.points[1:] + window.corner])
        sigma = np.hypot(line.sigma, self.backdrop.sway)
        sigma[0] = np.hypot(sigma[0], self.hand_sigma)
        near_line = rasterise(
            points - window.corner, frame.mask.shape, 9 + 2 * half_width
        )
        mask = window.paste(frame.mask & (near_line > 0), image.shape)
        return replace(line, points=points, sigma=sigma), mask

    def _arm_during_exposure(self, number: int) -> tuple[np.ndarray, float]:
        """Sample the arm's joints in the exposure, (M, J + 1, 2) [px]; find its blur.

        No joint moves more than a pixel between two samples. The blur is the distance
        that the fastest joint moves in the exposure [px].
        """
        if self.footage.body is None:
            return np.zeros((0, 2, 2)), 0.0
        neighbours = slice(max(number - 1, 0), number + 2)
        joints = self.camera.pixels(self.footage.body[neighbours])
        elapsed = max(float(np.ptp(self.footage.t[neighbours])), 1e-9)
        moved = (joints[-1] - joints[0]) / elapsed * self.camera.exposure
        blur = float(np.linalg.norm(moved, axis=-1).max())
        count = int(np.ceil(blur)) + 1
        share = (np.arange(count) + 0.5) / count - 0.5
        middle = self.camera.pixels(self.footage.body[number])
        return middle + share[:, None, None] * moved, blur


def _build_tables(
    t: np.ndarray,
    readings: list[FrameReading | str],
    s: np.ndarray,
    arm_fit: ArmFit | None,
) -> Points:
    """Build the artifact from the readings of frames at times t (F,) [s].

    s: (K,) arc lengths of the points [m].
    """
    rows, points, masks = [], [], []
    for number, reading in enumerate(readings):
        frame = {"frame": number, "t": t[number]}
        if isinstance(reading, str):
            unknown = dict.fromkeys(("tip_x", "tip_y", "tip_sigma", "length"), np.nan)
            rows.append({**frame, "valid": False, "reason": reading, **unknown})
            continue
        x, y = reading.points.T
        sigma = reading.sigma
        tip = {"tip_x": x[-1], "tip_y": y[-1], "tip_sigma": sigma[-1]}
        length = {"length": reading.length}
        rows.append({**frame, "valid": True, "reason": "", **tip, **length})
        line = {"t": t[number], "s": s, "x": x, "y": y, "by_share": True}
        points.append(pd.DataFrame({**line, "sigma": sigma, "valid": True}))
        masks.append({**frame, "png": reading.mask})
    table = pd.DataFrame(rows)
    if arm_fit is not None:
        table = table.assign(
            hand_shift=arm_fit.hand_shift, joint_error=arm_fit.joint_error
        )
    table = READINGS.check(table)
    if not points:
        return Points(POINTS.empty(), table, MASKS.empty())
    return Points(
        POINTS.check(pd.concat(points)), table, MASKS.check(pd.DataFrame(masks))
    )
