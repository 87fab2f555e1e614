"""Right data with unusual geometry, from simulators that differ from the model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stringcast.stages.check.consistency.record import Measurements, Recording, Track
from stringcast.stages.model.arm import Arm
from tests.benchmarks.simulators import load_simulator
from tests.benchmarks.simulators.drawing import configured_arm, draw_camera, draw_rod
from tests.benchmarks.simulators.motions import random_cast
from tests.benchmarks.simulators.scene import Fidelity, Scene

TRIALS = 3
NOISE_M = 7e-4
CLAMP_RATIO = 100.0  # stiffness of a clamp over that of the string


def scene_measurements(
    simulator: str,
    seed: int,
    length: float = 0.3,
    base: tuple[float, float] = (0.2, 0.2),
    links: tuple[float, ...] = (0.25, 0.2, 0.135),
    lowest: float | None = None,
    speed: float = 2.0,
    places: tuple[float, ...] = (0.5, 1.0),
    begin: float = 0.0,
    hidden: float = 0.0,
    set_per_m: float = 0.0,
    clamped: bool = False,
) -> Measurements:
    """Simulate casts and return their measurements.

    Parameters
    ----------
    simulator, seed
        One of the reference simulators, and the random seed.
    length, base, links
        Geometry [m].
    lowest
        Lowest angle of joint 1 [rad], at the start, with the hand up.
    speed
        Speed of the hand [m/s].
    places
        Arc lengths of visible points, in lengths.
    begin
        Share of each trial that is cut off, so that the string starts moving.
    hidden
        Share of the frames in which the tip is hidden.
    set_per_m
        Curvature of the string at rest [1/m], only with the own kernel.
    clamped
        Whether the grasp is far stiffer than the string.
    """
    rng = np.random.default_rng(seed)
    arm: Arm = replace(configured_arm(), base=base, links=links)
    if lowest is not None:
        arm = replace(arm, lowest=(lowest, *arm.lowest[1:]))
    s = np.array(places) * length
    rod, camera = draw_rod(rng, length), draw_camera(rng)
    if clamped:
        rod = rod._replace(grasp_stiffness=CLAMP_RATIO * rod.bending / length)
    scene = Scene(load_simulator(simulator), arm, camera, rod, (), s, NOISE_M)
    settings = {"rest_curvature.curvature": set_per_m} if set_per_m else {}
    recordings = []
    while len(recordings) < TRIALS:
        cast = random_cast(arm, rng, 200.0, speed)
        points = scene.observe(cast, settings, Fidelity.SEARCH)
        if not np.isfinite(points).all():
            continue
        points = points + NOISE_M * rng.standard_normal(points.shape)
        first = cast.frames[0] + begin * np.ptp(cast.frames)
        tracks = []
        for number, place in enumerate(s):
            kept = cast.frames >= first
            if hidden and number == len(s) - 1:
                middle = cast.frames.mean()
                kept &= np.abs(cast.frames - middle) > hidden / 2 * np.ptp(cast.frames)
            tracks.append(
                Track(
                    f"{number}", float(place), cast.frames[kept], points[kept, number]
                )
            )
        in_time = cast.t >= first
        recordings.append(
            Recording(
                f"t{len(recordings)}",
                cast.t[in_time],
                cast.reported[in_time],
                None,
                tuple(tracks),
                begin > 0,
            )
        )
    return Measurements(tuple(recordings), links, base, length)


UNUSUAL = {
    "usual": {},
    "long string": {"length": 0.9},
    "short string": {"length": 0.12},
    "high base": {"base": (0.0, 1.8)},
    "hand up": {"lowest": 1.2},
    "slow": {"speed": 0.5},
    "fast": {"speed": 5.0},
    "long links": {"links": (0.5, 0.45, 0.2)},
    "moving start": {"begin": 0.4},
    "tip hidden half of the time": {"hidden": 0.5},
    "tip only": {"places": (1.0,)},
    "inner half only": {"places": (0.25, 0.5)},
    "stiff clamp": {"clamped": True},
}
