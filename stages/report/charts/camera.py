"""Camera frames with target, obstacles and strings drawn on top."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stringcast.data.images import to_grey
from stringcast.data.lazy_module import LazyModule
from stringcast.stages.common import choose_evenly
from stringcast.stages.model.box import Box
from stringcast.stages.model.camera import Camera
from stringcast.stages.report.formatting import format_mm, format_ms
from stringcast.stages.report.records import CastRecord, RunRecord
from stringcast.stages.report.theme import (
    FRAME_COLOURS,
    MS_PER_S,
    Picture,
    data_uri,
    encode_webp,
    webp_picture,
)

cv2 = LazyModule("cv2")

REGION_MARGIN_M = 0.05  # around the points that a region shows
MIN_REGION_PX = 16
CORNER_SIGNS = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])  # of a box, in order


@dataclass(frozen=True)
class ImageRegion:
    """Region of an image: columns left to right - 1, rows top to bottom - 1."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def size_px(self) -> np.ndarray:
        """Width and height of the region."""
        return np.array([self.right - self.left, self.bottom - self.top])

    @property
    def x_limits(self) -> tuple[float, float]:
        """Outer edges of the first and last column."""
        return self.left - 0.5, self.right - 0.5

    @property
    def y_limits(self) -> tuple[float, float]:
        """Outer edges of the last and first row, for an axis that points up."""
        return self.bottom - 0.5, self.top - 0.5

    def crop(self, image: np.ndarray) -> np.ndarray:
        """Cut the region from an image, in grey."""
        return to_grey(image[self.top : self.bottom, self.left : self.right])


def region_around(record: RunRecord, world: np.ndarray) -> ImageRegion:
    """Return the region of the image that shows world points (N, 2) [m], except NaN."""
    camera = record.model.camera
    pixels = camera.pixels(world[np.isfinite(world).all(axis=1)])
    border = REGION_MARGIN_M * camera.px_per_m
    image_size = np.array([camera.width, camera.height])
    low = np.floor(pixels.min(axis=0) - border)
    low = np.clip(low, 0, image_size - MIN_REGION_PX).astype(int)
    high = np.ceil(pixels.max(axis=0) + border)
    high = np.clip(high, low + MIN_REGION_PX, image_size).astype(int)
    return ImageRegion(*low.tolist(), *high.tolist())


def widen_to_square(region: ImageRegion, camera: Camera) -> ImageRegion:
    """Widen a region around its middle to its height, within the image."""
    width, height = region.size_px
    if width >= height:
        return region
    left = np.clip(
        region.left - (height - width) // 2, 0, max(camera.width - height, 0)
    )
    right = min(left + height, camera.width)
    return replace(region, left=int(left), right=int(right))


def region_of_run(record: RunRecord) -> ImageRegion:
    """Return the region of the image that shows all casts of a run."""
    points = [np.array([record.model.arm.base]), box_corners(record.target)]
    points += map(box_corners, record.obstacles)
    looks = () if record.look is None else (record.look,)
    for cast in (*looks, *record.casts):
        points.append(cast.joint_positions(record.model.arm).reshape(-1, 2))
        points += [line[:, :2] for line in cast.centre_lines.values()]
    return region_around(record, np.concatenate(points))


def box_corners(box: Box) -> np.ndarray:
    """Return the corners of a box in order [m], shape (4, 2)."""
    return box.centre + CORNER_SIGNS * box.half_size


def blank_frame(region: ImageRegion, width: float) -> tuple[Figure, Axes]:
    """Create a figure of a width [inch], filled by a region of a frame."""
    columns, rows = region.size_px
    figure = Figure(figsize=(width, width * rows / columns))
    figure.set_layout_engine("none")
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    axes.set(xlim=region.x_limits, ylim=region.y_limits)
    return figure, axes


def draw_frame(
    axes: Axes, record: RunRecord, cast: CastRecord, frame: int, region: ImageRegion
) -> None:
    """Draw a frame, target, obstacles, and the strings simulated before and after."""
    black, white = cast.grey_range
    axes.imshow(
        region.crop(cast.trial.images[frame]),
        cmap="gray",
        vmin=black,
        vmax=white,
        extent=(*region.x_limits, *region.y_limits),
        aspect="auto",
        zorder=0,
    )
    colours, pixels = FRAME_COLOURS, record.model.camera.pixels
    for obstacle in record.obstacles:
        corners = pixels(box_corners(obstacle))
        axes.fill(*corners.T, facecolor=colours["wall"], alpha=0.55)
    corners = pixels(box_corners(record.target))
    axes.fill(*corners.T, fill=False, edgecolor=colours["target"], lw=1.5)
    draw_line(axes, record, cast.before[frame], color=colours["before"], lw=1.5)
    draw_line(axes, record, cast.after[frame], color=colours["after"], lw=1.5)


def draw_line(axes: Axes, record: RunRecord, world: np.ndarray, **style: Any) -> None:
    """Draw a line through world points [m], shape (K, 2), if all are finite."""
    if np.isfinite(world).all():
        axes.plot(*record.model.camera.pixels(world).T, **style)


# --- the closest approach
TIP_PATH_HALF_WINDOW_S = 0.03


def closest_approach_picture(record: RunRecord, cast: CastRecord) -> Picture | None:
    """Draw the frame nearest in time, cropped to strings and target."""
    if not len(cast.trial.images):
        return None
    frame = cast.closest_frame
    shown = [cast.before[frame], cast.after[frame], box_corners(record.target)]
    centre_line = cast.centre_line(frame)
    region = region_around(record, np.concatenate([*shown, centre_line]))
    region = widen_to_square(region, record.model.camera)
    figure, axes = blank_frame(region, 5.4)
    draw_frame(axes, record, cast, frame, region)
    measured = {"color": FRAME_COLOURS["measured"]}
    draw_line(axes, record, centre_line, ls="", marker=".", ms=2.5, **measured)

    # the tip's path, and a ring where it is closest
    verdict = cast.verdict
    window = np.linspace(-TIP_PATH_HALF_WINDOW_S, TIP_PATH_HALF_WINDOW_S, 121)
    path = cast.tip_path(verdict.t + window)
    path = path[np.isfinite(path).all(axis=1)]
    draw_line(axes, record, path, lw=0.9, ls=(0, (2, 2)), **measured)
    closest = cast.tip_path(np.array([verdict.t]))
    draw_line(
        axes, record, closest, color=FRAME_COLOURS["ink"], marker="o", ms=8, mfc="none"
    )

    position = "not visible"
    if np.isfinite(verdict.distance):
        position = (
            f"{format_mm(verdict.distance)} from its centre at "
            f"{format_ms(verdict.t, 1)}"
        )
    words = (
        f"Camera frame at {format_ms(cast.frame_times[frame])}, with the target box "
        "and the string as measured and as simulated before and after estimation. The "
        f"tip is {position}."
    )
    return webp_picture(figure, words)


# --- the film
MAX_PAGE_FRAMES = 100  # shared among the casts of a page
MIN_CAST_FRAMES = 10
FILM_SIZE_PX = 440  # of the longer side
# Scale and quality of WebP, tried in order until a frame is small enough. 100 frames of
# the largest size are 0.33 MB of a page's 1.5 MB.
COMPRESSION_STEPS = ((1.0, 45), (1.0, 25), (1.0, 12), (0.5, 45), (0.5, 25))
MAX_FRAME_BYTES = 2_500
STILL_COUNT = 6
FILM_MARGIN_S = 0.03  # before and after the movement


def cast_film_data(
    record: RunRecord, cast: CastRecord, region: ImageRegion
) -> dict[str, Any] | None:
    """Return the data of a cast's film for the page's script, or None without frames.

    They can be written as JSON; coordinates are pixels of the film, times are in ms.
    """
    if not len(cast.trial.images):
        return None
    scale = FILM_SIZE_PX / float(region.size_px.max())
    film_pixels = partial(_film_pixels, record.model.camera, region, scale)
    width, height = np.round(region.size_px * scale).astype(int).tolist()
    film_count = len(record.casts) + (record.look is not None)
    frames = choose_frames(cast, max(MAX_PAGE_FRAMES // film_count, MIN_CAST_FRAMES))

    boxes = [(FRAME_COLOURS["target"], film_pixels(box_corners(record.target)))]
    for obstacle in record.obstacles:
        boxes.append((FRAME_COLOURS["wall"], film_pixels(box_corners(obstacle))))
    times = []
    images = []
    strings: dict[str, list[Any]] = {"before": [], "after": [], "measured": []}
    for frame in frames:
        times.append(round(float(cast.frame_times[frame]) * MS_PER_S, 1))
        image = region.crop(cast.trial.images[frame])
        images.append(_encode_frame(image, cast.grey_range, scale))
        strings["before"].append(film_pixels(cast.before[frame]))
        strings["after"].append(film_pixels(cast.after[frame]))
        strings["measured"].append(film_pixels(cast.centre_line(frame)))
    stills = []
    for number in choose_evenly(len(frames), STILL_COUNT):
        stills.append((int(number), format_ms(cast.frame_times[frames[number]])))
    closest = cast.closest_frame
    return {
        "width": width,
        "height": height,
        "t": times,
        "start": frames.index(closest) if closest in frames else 0,
        "frames": images,
        "boxes": boxes,
        "stills": stills,
        "strings": strings,
    }


def _film_pixels(
    camera: Camera, region: ImageRegion, scale: float, world: np.ndarray
) -> list[list[float]]:
    """Return points (n, 2) [m] as pixels of the film; empty if the string diverged.

    scale: pixels of the film over those of the camera.
    """
    if not np.isfinite(world).all():
        return []
    on_film = (camera.pixels(world) - (region.left, region.top) + 0.5) * scale
    return np.round(on_film, 1).tolist()


def choose_frames(cast: CastRecord, count: int) -> list[int]:
    """Choose at most `count` frames evenly over the movement.

    They include the frame of the closest approach.
    """
    first = cast.frame_at(-FILM_MARGIN_S)
    last = cast.frame_at(cast.motion.duration + FILM_MARGIN_S)
    chosen = np.linspace(first, last, min(count, last - first + 1)).round().astype(int)
    if np.isfinite(cast.verdict.t):
        chosen[np.argmin(np.abs(chosen - cast.closest_frame))] = cast.closest_frame
    return sorted(set(chosen.tolist()))


def _encode_frame(
    image: np.ndarray, grey_range: tuple[float, float], scale: float
) -> str:
    """Stretch the grey levels of a frame and encode it, at its filmed size or less."""
    black, white = grey_range
    spread = (image.astype(np.float32) - black) * (255 / (white - black))
    image = np.clip(spread, 0, 255).astype(np.uint8)
    for reduction, quality in COMPRESSION_STEPS:
        factor = min(scale, 1.0) * reduction
        small = cv2.resize(
            image, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA
        )
        content = encode_webp(small, quality)
        if len(content) <= MAX_FRAME_BYTES:
            break
    return data_uri("webp", content)
