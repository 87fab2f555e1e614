"""Synthetic recordings whose arm and camera have clocks of their own."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from stringcast.data.artifacts import JOINTS, MASKS, READINGS, Observation
from stringcast.stages.model.arm import Arm
from tests.benchmarks.simulators import load_simulator
from tests.benchmarks.simulators.causes import Cause
from tests.benchmarks.simulators.dataset import trial_name
from tests.benchmarks.simulators.drawing import (
    Redraw,
    configured_arm,
    correlated_noise,
    draw_camera,
    draw_rod,
    draw_size,
    hide_cause,
    plain_trials,
)
from tests.benchmarks.simulators.motions import MOTIONS, Cast, fastest_hand, perform
from tests.benchmarks.simulators.scene import Fidelity, Scene, Simulator

SIMULATORS = ("nodal", "pyelastica")
# of the whole motion [s], and of the fastest hand [m/s]
DURATIONS_S = {"slow": (1.0, 2.0), "cast": (0.45, 0.85)}
SPEEDS = {"slow": (0.25, 0.9), "cast": (1.2, 4.0)}
REST_RANGE_S = (0.1, 0.4)  # before and after the motion, in the arm's log
SIGMA_RANGE_M = (3e-4, 2e-3)
TRIALS = (3, 5)
MAX_TRIES = 40  # motions for a trial
SPEED_TOLERANCE = 1.1
HOURS_S = 2e4  # by which clocks may differ that do not start together
SECONDS_S = 0.3  # by which clocks differ that do
# Faults of clocks and delays are the offset itself, or change what it means.
CLOCK_CAUSES = ("time_offset", "clock_drift", "clock_jump", "arm_lag")


@dataclass(frozen=True)
class Circumstances:
    """What a seed means.

    Parameters
    ----------
    seed : of string, motions, noise and clock
    simulator : of SIMULATORS
    motion : slow or cast
    points : 1 for the tip alone, 2 with the middle
    is_plain : whether no cause is hidden
    """

    seed: int
    simulator: str
    motion: str
    points: int
    is_plain: bool

    @classmethod
    def of_seed(cls, seed: int) -> Circumstances:
        """Return the circumstances of a seed: any 16 in a row are all different."""
        return cls(
            seed,
            SIMULATORS[seed % 2],
            ("slow", "cast")[seed // 2 % 2],
            1 + seed // 4 % 2,
            seed // 8 % 2 == 0,
        )


@dataclass(frozen=True)
class Recording:
    """Trials as an importer reads them, with the hidden truth.

    Parameters
    ----------
    observations : joint angles by the arm's clock, points by the camera's
    arm : the arm
    length : of the string [m]
    fps : frames per second
    sigma : noise [m]
    offset : to be added to the times of points [s]
    cause : name of the hidden cause, empty if there is none
    """

    observations: tuple[Observation, ...]
    arm: Arm
    length: float
    fps: float
    sigma: float
    offset: float
    cause: str


def draw_recording(circumstances: Circumstances) -> Recording:
    """Draw the recording of a seed."""
    rng = np.random.default_rng([circumstances.seed, 57])
    simulator = load_simulator(circumstances.simulator)
    while True:
        try:
            return _try_to_draw(circumstances, simulator, rng)
        except Redraw:
            continue


def _try_to_draw(
    circumstances: Circumstances, simulator: Simulator, rng: np.random.Generator
) -> Recording:
    length = float(rng.uniform(0.25, 0.35))
    sigma = float(np.exp(rng.uniform(*np.log(SIGMA_RANGE_M))))
    shares = [1.0] if circumstances.points == 1 else [float(rng.uniform(0.4, 0.6)), 1.0]
    camera = draw_camera(rng)
    arm = configured_arm()
    rod = draw_rod(rng, length)
    s = np.array(shares) * length
    scene = Scene(simulator, arm, camera, rod, (), s, sigma)
    count = int(rng.integers(TRIALS[0], TRIALS[1] + 1))
    scene = scene.with_casts(
        [_draw_cast(circumstances, scene, rng) for _ in range(count)]
    )

    settings, only_cast, name = _draw_cause(circumstances, scene, rng)
    extent = HOURS_S if rng.uniform() < 0.5 else SECONDS_S
    offset = float(rng.uniform(-extent, extent))
    observations = []
    for number, cast in enumerate(scene.casts):
        active = settings if only_cast in (None, number) else {}
        exact = scene.observe(cast, active, Fidelity.CHECK)
        if not np.isfinite(exact).all():
            raise Redraw
        seen = exact + sigma * correlated_noise(rng, exact.shape)
        observations.append(_observation(number, cast, seen, s, offset))
    return Recording(tuple(observations), arm, length, camera.fps, sigma, offset, name)


def _draw_cast(
    circumstances: Circumstances, scene: Scene, rng: np.random.Generator
) -> Cast:
    """Draw a motion between rests, that is not chaotic, filmed from about its start."""
    arm = scene.arm
    for _ in range(MAX_TRIES):
        duration = float(rng.uniform(*DURATIONS_S[circumstances.motion]))
        speed = float(np.exp(rng.uniform(*np.log(SPEEDS[circumstances.motion]))))
        before, after = rng.uniform(*REST_RANGE_S, 2)
        ticks = np.arange(
            -round(before / arm.tick), round((duration + after) / arm.tick)
        )
        t = ticks * arm.tick
        progress = np.clip(t / duration, 0, 1)
        swing = MOTIONS[rng.integers(len(MOTIONS))](rng, progress, len(arm.links))
        start = rng.uniform(arm.lowest, arm.highest)
        for _ in range(3):
            swing = swing * speed / fastest_hand(arm, start + swing)
        angles = start + swing
        within = (angles > arm.lowest).all() and (angles < arm.highest).all()
        if not within or fastest_hand(arm, angles) > SPEED_TOLERANCE * speed:
            continue
        cast = perform(arm, t, angles, rng, scene.camera.fps)
        first = t[0] + rng.uniform() * 0.8 * before
        cast = replace(cast, frames=cast.frames[cast.frames > first])
        coarse = scene.observe(cast, {}, Fidelity.SEARCH)
        finer = scene.observe(cast, {}, Fidelity.SCREENING)
        gap = np.linalg.norm((coarse - finer)[:, -1], axis=-1)
        if np.isfinite(gap).all() and gap.max() < scene.simulator.screening_tolerance:
            return cast
    raise Redraw


def _draw_cause(
    circumstances: Circumstances, scene: Scene, rng: np.random.Generator
) -> tuple[dict[str, float], int | None, str]:
    """Return the settings of a cause, the one trial in which it acts, and its name."""
    if circumstances.is_plain:
        return {}, None, ""
    causes: list[Cause] = []
    for cause in scene.simulator.causes:
        if cause.name not in CLOCK_CAUSES:
            causes.append(cause)
    cause = causes[int(rng.integers(len(causes)))]
    size_m = draw_size(cause, rng)
    trials = plain_trials(scene)
    hidden, share = hide_cause(scene, cause, size_m, trials, rng)
    return hidden.settings(share), hidden.only_trial, cause.name


def _observation(
    number: int, cast: Cast, seen: np.ndarray, s: np.ndarray, offset: float
) -> Observation:
    """Return a trial with each clock as its computer keeps it."""
    t, arc = np.meshgrid(cast.frames - offset, s, indexing="ij")
    x, y = seen.reshape(-1, 2).T
    columns = {"t": t.ravel(), "s": arc.ravel(), "x": x, "y": y, "valid": True}
    joints = dict(zip(JOINTS, cast.reported.T, strict=True))
    return Observation(
        trial_name(number),
        pd.DataFrame(columns),
        READINGS.empty(),
        MASKS.empty(),
        arm=pd.DataFrame({"t": cast.t} | joints),
    )
