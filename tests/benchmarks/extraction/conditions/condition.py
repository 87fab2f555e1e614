"""Conditions: the base class, and the filming of a shot under any number of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stringcast.hardware.virtual import render
from stringcast.hardware.virtual.bench import EXPOSURE_MOMENTS, VirtualBench
from stringcast.hardware.virtual.render import (
    Look,
    add_sensor_noise,
    render_background,
    render_frame,
)
from stringcast.stages.model.camera import Camera

SHOT_STEP_S = 2.5e-4  # [s] between the moments a shot is kept at
MAX_EXPOSURE_MOMENTS = 32  # moments drawn in one exposure at most


@dataclass(frozen=True)
class Shot:
    """A scene that the camera is about to film."""

    camera: Camera
    look: Look
    wall: np.ndarray
    frame_times: np.ndarray
    times: np.ndarray
    joints: np.ndarray
    strings: np.ndarray

    @property
    def truth(self) -> np.ndarray:
        """The string in the middle of each exposure, (F, n, 2) [m]."""
        return interpolate(self.frame_times, self.times, self.strings)


@dataclass(frozen=True)
class ExposureMoment:
    """The state of the scene while the shutter is open.

    `joints` (K, J + 1, 2) and `strings` (K, n, 2) are in metres. `rng` is its source of
    chance.
    """

    shot: Shot
    number: int
    t: float
    joints: np.ndarray
    strings: np.ndarray
    rng: np.random.Generator


def line_coverage(camera: Camera, line: np.ndarray, width: float) -> np.ndarray:
    """Compute the fraction of each pixel that a polyline (n, 2) [m] covers.

    width: of the line [m].
    """
    shape = camera.height, camera.width
    pixels = camera.pixels(line)
    return render.line_coverage(shape, pixels, width * camera.px_per_m)


class Condition:
    """One thing that makes a film harder to read.

    Each member is frozen data and overrides the methods that it needs.
    """

    def change_scene(self, shot: Shot) -> Shot:
        """Change what is filmed, before anything is drawn."""
        return shot

    def change_background(self, wall: np.ndarray, moment: ExposureMoment) -> np.ndarray:
        """Change the background of one frame.

        `wall` is (height, width) float32.
        """
        return wall

    def change_light(self, frame: np.ndarray, moment: ExposureMoment) -> np.ndarray:
        """Change the light that falls on the sensor.

        `frame` is (height, width) float32.
        """
        return frame

    def change_stored_images(
        self, images: Sequence[np.ndarray], fps: float
    ) -> Sequence[np.ndarray]:
        """Change the film as it is read again from storage.

        `images` are F images (height, width) uint8.
        """
        return images


def prepare_shot(bench: VirtualBench, t: np.ndarray) -> Shot:
    """Prepare the shot of a bench's last performed motion at times t (F,) [s]."""
    # an exposure reaches half of an interval beyond its frame's time at most
    margin = 0.6 / bench.camera.fps
    times = np.arange(t[0] - margin, t[-1] + margin, SHOT_STEP_S)
    wall = render_background(bench.camera, bench.look, bench.seed)
    return Shot(
        bench.camera,
        bench.look,
        wall,
        t,
        times,
        bench.joints_at(times),
        bench.string_at(times),
    )


def film_shot(
    shot: Shot, conditions: Sequence[Condition], seed: int
) -> Sequence[np.ndarray]:
    """Film a staged shot as F uint8 images (height, width).

    `seed` determines all chance in them.
    """
    images = []
    for number in range(len(shot.frame_times)):
        moment = open_shutter(shot, number, seed)
        wall = shot.wall
        for condition in conditions:
            wall = condition.change_background(wall, moment)
        light = render_frame(
            shot.camera, shot.look, moment.joints, moment.strings, wall
        )
        for condition in conditions:
            light = condition.change_light(light, moment)
        images.append(add_sensor_noise(light, shot.look, moment.rng))
    for condition in conditions:
        images = list(condition.change_stored_images(images, shot.camera.fps))
    return images


def open_shutter(shot: Shot, number: int, seed: int) -> ExposureMoment:
    """Return arm and string while the shutter is open.

    The moments are about a pixel apart.
    """
    t, half = shot.frame_times[number], shot.camera.exposure / 2
    ends = interpolate(np.array([t - half, t + half]), shot.times, shot.strings)
    blur = np.linalg.norm(ends[1] - ends[0], axis=-1).max() * shot.camera.px_per_m
    open_shutter = np.linspace(
        t - half, t + half, int(np.clip(blur, EXPOSURE_MOMENTS, MAX_EXPOSURE_MOMENTS))
    )
    joints, strings = (
        interpolate(open_shutter, shot.times, which)
        for which in (shot.joints, shot.strings)
    )
    return ExposureMoment(
        shot, number, float(t), joints, strings, np.random.default_rng([seed, number])
    )


def interpolate(t: np.ndarray, times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Interpolate values linearly at other times.

    t has shape (F,), times (M,), values (M, ...), and the result (F, ...).
    """
    after = np.clip(np.searchsorted(times, t), 1, len(times) - 1)
    share = np.clip((t - times[after - 1]) / (times[after] - times[after - 1]), 0, 1)
    share = share.reshape(-1, *[1] * (values.ndim - 1))
    return (1 - share) * values[after - 1] + share * values[after]
