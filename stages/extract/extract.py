"""Read the string in every frame; what cannot be read is marked invalid with the
reason.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import cv2
import numpy as np
import pandas as pd
from pydantic import Field

from stringcast.data.artifacts import MASKS, POINTS, READINGS, Film, Points, Trial
from stringcast.data.images import CachedImages
from stringcast.data.schema import DataError
from stringcast.stages.common import Progress
from stringcast.stages.extract.centreline import (
    HALF_WIDTHS,
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
    arm_silhouette,
    estimate_background,
    fill_never_uncovered,
    half_width,
    half_widths,
    pack_mask,
    segment_frame,
    string_brightness,
    uncovered_brightness,
)
from stringcast.stages.extract.stabilise import sample_numbers, stabilise_film
from stringcast.stages.extract.window import window_around
from stringcast.stages.model.camera import Camera
from stringcast.stages.spec import StageCall

MARGIN_PX = 12.0  # [px] around what the string can reach
# [px] by how much half the string's width may be more than in the other frames
BLUR_FACTOR = 2.0
# of what a point is moved along the line because tension is not the same all along: may
# be wrong
MAX_LENGTH_ERROR = 0.3
# [px] half width from which brightness alone does not show where the middle is
MAX_WIDTH_RATIO = 3.0


@dataclass(frozen=True)
class FrameReading:
    """One frame: points (K, 2) [m], sigma (K,) [m], mask as PNG, length of the line
    [m].
    """

    points: np.ndarray
    sigma: np.ndarray
    mask: bytes
    length: float


def run(call: StageCall, trial: Trial | Film) -> Points:
    """The string in each frame of a trial of ours or a film of others, as a stage."""
    film = trial if isinstance(trial, Film) else trial.film
    model = call.setup.model
    made: Points = call.by(
        aligned_footage(film, model), model.camera, progress=call.progress
    )
    return made


def extract(
    footage: Footage,
    camera: Camera,
    *,
    string_length: Annotated[float, Field(gt=0)],
    points: Annotated[int, Field(ge=2)],
    sigmas: Annotated[float, Field(gt=0)],
    arm_width: Annotated[float, Field(ge=0)],
    hidden: Annotated[float, Field(ge=0)],
    shorter: Annotated[float, Field(gt=0, lt=1)],
    longer: Annotated[float, Field(gt=0)],
    progress: Progress = lambda share: None,
) -> Points:
    """The string in each frame.

    string_length: from grasp to tip [m]. points: how many are reported along it.
    sigmas: threshold above noise. arm_width: of the limbs to be masked [m]. hidden:
    length near the grasp that may be out of sight [m]. shorter, longer: by how much of
    the string's length the line may differ before the frame is refused (a swung string
    stretches).
    """
    rows, columns = footage.images[0].shape
    if (columns, rows) != (camera.width, camera.height):
        raise DataError(
            f"camera.width x camera.height is {camera.width} x {camera.height}, the frames are {columns} x {rows} px. "
            "Say so in the dataset's dataset.yaml, or in conf/camera."
        )
    images, sway = stabilise_film(CachedImages(footage.images))
    footage = replace(footage, images=images)
    reach = string_length * (1 + longer) * camera.px_per_m + MARGIN_PX
    backdrop = _estimate_backdrop(footage, camera, string_length, arm_width, sway)
    readings: list[FrameReading | str] = []
    for number in range(len(footage.t)):
        try:
            line, mask = _find_line(
                footage, number, backdrop, camera, reach, sigmas, arm_width, hidden
            )
            readings.append(
                _read_points(
                    line,
                    mask,
                    camera,
                    np.linspace(0, string_length, points),
                    shorter,
                    longer,
                )
            )
        except UnreadableError as reason:
            readings.append(str(reason))
        progress((number + 1) / len(footage.t))
    return _build_tables(footage.t, readings, np.linspace(0, string_length, points))


def _estimate_backdrop(
    footage: Footage,
    camera: Camera,
    string_length: float,
    arm_width: float,
    sway: float,
) -> Backdrop:
    """The scene shared by all frames, from a sample of them. sway: one sigma of where
    the camera looks [px].
    """
    images, chosen = footage.images, sample_numbers(len(footage.images))
    frames = [
        image if image.dtype == np.uint8 else cv2.convertScaleAbs(image)
        for image in (images[i] for i in chosen)
    ]
    bodies = (
        np.zeros((len(footage.t), 0, 2))
        if footage.body is None
        else camera.pixels(footage.body)
    )
    arms = [
        pack_mask(
            arm_silhouette(
                frames[0].shape, bodies[i][None], arm_width * camera.px_per_m
            )
        )
        for i in chosen
    ]
    low = uncovered_brightness(frames)
    half = half_widths(frames, low, arms)
    scene = estimate_background(frames, arms, low, half)
    scene = fill_never_uncovered(
        scene, camera.pixels(footage.grasp[:, :2]), string_length * camera.px_per_m
    )
    return Backdrop(scene, string_brightness(footage.images, scene), half, sway)


def _find_line(
    footage: Footage,
    number: int,
    backdrop: Backdrop,
    camera: Camera,
    reach: float,
    sigmas: float,
    arm_width: float,
    hidden: float,
) -> tuple[Centreline, np.ndarray]:
    """The centre-line [px] in one frame, beginning at the grasp, and its binary image.
    reach: of the string [px].
    """
    grasp = camera.pixels(footage.grasp[number, :2])
    image = footage.images[number]
    window = window_around(grasp, reach, image.shape)
    if min(window.shape) < 2 * HALF_WIDTHS:
        raise UnreadableError("the grasp is out of view")

    # the arm's joints (K, J + 1, 2) at moments of the exposure, and how far the fastest
    # moves in it [px]
    moments, blur = np.zeros((0, 0, 2)), 0.0
    if footage.body is not None:
        beside = slice(max(number - 1, 0), number + 2)
        near = camera.pixels(footage.body[beside])
        moved = (
            (near[-1] - near[0])
            / max(float(np.ptp(footage.t[beside])), 1e-9)
            * camera.exposure
        )
        blur = float(np.linalg.norm(moved, axis=-1).max())
        count = int(np.ceil(blur)) + 1
        share = (np.arange(count) + 0.5) / count - 0.5
        moments = camera.pixels(footage.body[number]) + share[:, None, None] * moved

    part = replace(backdrop, scene=window.cut(backdrop.scene))
    seen = segment_frame(
        window.cut(image),
        part,
        moments - window.corner,
        arm_width * camera.px_per_m,
        blur,
        sigmas,
    )
    half = min(half_width(seen.mask), backdrop.half + BLUR_FACTOR)
    ridge = (
        cv2.GaussianBlur(seen.light, (0, 0), 0.6 * half)
        if half > MAX_WIDTH_RATIO
        else seen.light
    )
    way = trace_line(
        ridge,
        seen.mask,
        seen.arm,
        grasp - window.corner,
        start_radius=hidden * camera.px_per_m + 8,
    )
    line = refine_line(seen.light, seen.outline, way, seen.noise, half)
    check_line(line, seen.mask, half)
    points = np.concatenate([grasp[None], line.points[1:] + window.corner])
    whole = replace(line, points=points, sigma=np.hypot(line.sigma, backdrop.sway))
    beside_it = rasterise(whole.points - window.corner, seen.mask.shape, 9 + 2 * half)
    return whole, window.paste(seen.mask & (beside_it > 0), image.shape)


def arc_lengths_on_line(s: np.ndarray, length: float) -> np.ndarray:
    """Arc lengths (K,) [m] on a line of this length of those at rest s (K,), whose last
    is the tip's.

    A string that is longer than it was is drawn: by the tension of what is beyond each
    point, which falls to nothing at the free end, evenly where the string is thrown
    straight. A line that is shorter was read short all along.
    """
    share, more = s / s[-1], max(length - s[-1], 0.0)
    return np.asarray(share * (length - more) + more * share * (2 - share))


def _read_points(
    line: Centreline,
    mask: np.ndarray,
    camera: Camera,
    s: np.ndarray,
    shorter: float,
    longer: float,
) -> FrameReading:
    """Points at equal arc lengths; refuses a line that is not as long as the string."""
    world = camera.world(line.points)
    depth = cumulative_length(world)
    length = float(depth[-1])
    if not s[-1] * (1 - shorter) <= length <= s[-1] * (1 + longer):
        raise UnreadableError(
            f"the line is {'shorter' if length < s[-1] else 'longer'} than the string"
        )
    end = line.points[-1]
    if not (1 <= end[0] <= camera.width - 2 and 1 <= end[1] <= camera.height - 2):
        raise UnreadableError("the string leaves the picture")
    wanted = arc_lengths_on_line(s, length)
    at = np.stack([np.interp(wanted, depth, world[:, i]) for i in (0, 1)], axis=-1)
    good, png = cv2.imencode(".png", mask * 255, [cv2.IMWRITE_PNG_BILEVEL, 1])
    assert good
    sigma = np.hypot(
        np.interp(wanted, depth, line.sigma) / camera.px_per_m,
        MAX_LENGTH_ERROR * (wanted - length * s / s[-1]),
    )
    return FrameReading(at, sigma, png.tobytes(), length)


def _build_tables(
    t: np.ndarray, readings: list[FrameReading | str], s: np.ndarray
) -> Points:
    """Everything read, as tables. t: (F,) times of the frames [s]. s: (K,) arc lengths
    of the points [m].
    """
    rows: list[dict[str, object]] = []
    for number, reading in enumerate(readings):
        if isinstance(reading, str):  # why it could not be read
            found = dict.fromkeys(("tip_x", "tip_y", "tip_sigma", "length"), np.nan)
            rows.append(
                {"frame": number, "t": t[number], "valid": False, "reason": reading}
                | found
            )
        else:
            x, y = reading.points[-1]
            tip = {
                "tip_x": x,
                "tip_y": y,
                "tip_sigma": float(reading.sigma[-1]),
                "length": reading.length,
            }
            rows.append(
                {"frame": number, "t": t[number], "valid": True, "reason": ""} | tip
            )
    table = READINGS.check(pd.DataFrame(rows)) if rows else READINGS.empty()
    good = [
        (number, reading)
        for number, reading in enumerate(readings)
        if isinstance(reading, FrameReading)
    ]
    if not good:
        return Points(POINTS.empty(), table, MASKS.empty())
    frames, read = [number for number, _ in good], [reading for _, reading in good]
    places = {"t": np.repeat(t[frames], len(s)), "s": np.tile(s, len(frames))}
    places |= dict(
        zip("xy", np.concatenate([reading.points for reading in read]).T, strict=True)
    )
    places |= {"sigma": np.concatenate([reading.sigma for reading in read])}
    masks = {"frame": frames, "t": t[frames], "png": [reading.mask for reading in read]}
    return Points(
        POINTS.check(pd.DataFrame(places).assign(valid=True)),
        table,
        MASKS.check(pd.DataFrame(masks)),
    )
