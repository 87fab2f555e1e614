"""Excite: a motion from whose film camera and clock are measured, slow enough to be
safe.

Each joint swings by a sum of sines that begins and ends at rest; of many drawn that the
arm may do, the one is taken that tells the most about all parameters together
(D-optimality; Swevers et al., Optimal robot excitation and identification, 1997), and
of these the clocks count more. Changes of direction at several frequencies are what
tells a lag, which swallows the quick ones, from a clock that is off.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Annotated

import numpy as np
import pandas as pd
from pydantic import Field

from stringcast.data.artifacts import (
    ATTEMPTS,
    COMMANDS,
    CONTROL_POINTS,
    JOINTS,
    MOTION_OUTCOME,
    PREDICTED_STRING,
    SPEEDS,
    Motion,
)
from stringcast.data.schema import DataError
from stringcast.stages.align.fit import (
    CANDIDATE_EFFECTS,
    REQUIRED_EFFECTS,
    AlignmentProblem,
    measurement_model,
)
from stringcast.stages.align.grasp import hand_sightings
from stringcast.stages.align.lookalike import LAG, OFFSET
from stringcast.stages.align.sightings import SightedTrial
from stringcast.stages.common import Progress
from stringcast.stages.generate.generate import arm_faults
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.box import Box
from stringcast.stages.model.hand import JointMotion
from stringcast.stages.model.model import Model
from stringcast.stages.spec import StageCall

RAMP_FRACTION = 0.2  # share of the time in which the swing grows, and in which it fades
RANGE_MARGIN = 0.03  # of the picture's width that stays free around the arm
# more times that the clocks count: what nobody sees, such as a faint rolling shutter,
# must not move them
CLOCK_PARAMETERS = 2
# where the design is judged: at no lag it would look like an offset
TYPICAL_VALUES = {LAG: 0.005}
SIGHTING_SIGMA_M = 0.01  # [s] between the sightings for which it is judged


def run(call: StageCall) -> Motion:
    """The motion, as a stage."""
    made: Motion = call.by(
        call.setup.model, call.setup.obstacles, seed=call.seed, progress=call.progress
    )
    return made


def excite(
    model: Model,
    obstacles: Sequence[Box],
    *,
    seed: int,
    duration: Annotated[float, Field(gt=0.5, le=60)],
    speed: Annotated[float, Field(gt=0)],
    highest: Annotated[float, Field(gt=0)],
    sines: Annotated[int, Field(ge=1)],
    motions: Annotated[int, Field(ge=1)],
    progress: Progress = lambda share: None,
) -> Motion:
    """The motion. duration: [s]. speed: of the hand at most [m/s]. highest: frequency
    of a sine [Hz]. sines: of each joint. motions: drawn, of which the best is taken.

    The hand stays a string's length away from obstacles, so that no string in it can
    touch one however it swings. Raises DataError where no motion drawn is allowed, or
    no sine of `highest` fits into `duration`.
    """
    if highest * duration < 1:
        raise DataError(
            f"excite.highest={highest:g} Hz (conf/excite) does not come round once in excite.duration={duration:g} s. "
            "Raise one of them."
        )
    rng = np.random.default_rng(seed)
    count: Counter[str] = Counter()
    best, most = None, -np.inf
    for number in range(motions):
        angles, speeds = draw_swings(model.arm, rng, duration, speed, highest, sines)
        reason = violated_limit(model, obstacles, angles, speeds)
        count[reason or "allowed"] += 1
        content = -np.inf if reason else alignment_information(model, angles, speeds)
        if content > most:
            best, most = angles, content
        progress((number + 1) / motions)
    if best is None:
        reasons = "; ".join(
            f"{reason}: {times}" for reason, times in count.most_common()
        )
        remedy = "Lower excite.speed, draw more of them, or make room."
        raise DataError(
            f"no motion of excite.motions={motions} is allowed ({reasons}). {remedy}"
        )
    return build_motion(model.arm, best, count)


def draw_swings(
    arm: Arm,
    rng: np.random.Generator,
    duration: float,
    speed: float,
    highest: float,
    sines: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Angles and speeds (K, J) on the arm's tick of random swings about a random pose,
    the hand as fast as `speed`.
    """
    t = np.arange(round(duration / arm.tick) + 1) * arm.tick
    lowest, top = np.asarray(arm.lowest), np.asarray(arm.highest)
    middle = (lowest + top) / 2 + rng.uniform(-0.3, 0.3, len(lowest)) * (top - lowest)
    frequency = rng.uniform(1 / duration, highest, (sines, len(lowest)))
    phase, size = (
        rng.uniform(0, 2 * np.pi, frequency.shape),
        rng.uniform(0.3, 1, frequency.shape) / frequency,
    )
    swing = np.sum(
        size * np.sin(2 * np.pi * frequency * t[:, None, None] + phase), axis=1
    )
    ends = np.minimum(t / t[-1], 1 - t / t[-1])
    x = np.clip(ends / RAMP_FRACTION, 0, 1)
    # from 0 to 1 and back, with no jump of the second derivative
    swing *= (x**3 * (10 - 15 * x + 6 * x**2))[:, None]
    rate = np.gradient(swing, arm.tick, axis=0)

    def fastest(share: float) -> float:
        return float(
            np.linalg.norm(
                arm.grasp_velocity(middle + share * swing, share * rate)[:, :2], axis=-1
            ).max()
        )

    # as large a swing as lets the hand reach `speed`, and never exceed it
    share = 1.0
    for _ in range(3):  # the lever changes with the angles
        share *= 0.99 * speed / fastest(share)
    while fastest(share) > speed:
        share *= 0.99
    return middle + share * swing, share * rate


def violated_limit(
    model: Model, obstacles: Sequence[Box], angles: np.ndarray, speeds: np.ndarray
) -> str:
    """The limit that a motion (K, J) violates, in words; empty if none."""
    arm, camera = model.arm, model.camera
    reason = str(arm_faults(arm, obstacles, angles[None], speeds[None])[0])
    joints = arm.joint_positions(angles)
    if any(
        box.distance_to(x, y) < model.string.length
        for box in obstacles
        for x, y in joints[::4, -1]
    ):
        return reason or "the string could touch an obstacle"
    edge = RANGE_MARGIN * camera.width
    pixels = camera.pixels(joints[:, 1:])
    inside = (pixels >= edge) & (
        pixels <= np.array([camera.width, camera.height]) - 1 - edge
    )
    return reason or ("" if inside.all() else "the arm leaves the picture")


def alignment_information(
    model: Model, angles: np.ndarray, speeds: np.ndarray
) -> float:
    """The information of a motion about the alignment. angles, speeds: (K, J) [rad],
    [rad/s].

    Logarithm of the determinant of the Fisher information of all parameters, and CLOCKS
    times that of the clocks, the others but for a lag being unknown: with a lag, only
    the sum of the two is measured.
    """
    motion = JointMotion(0.0, model.arm.tick, angles[None], speeds[None])
    times = np.arange(0, (len(angles) - 1) * model.arm.tick, SIGHTING_SIGMA_M)
    # wherever it is seen
    hand = hand_sightings(
        times, np.zeros((len(times), 2)), np.ones(len(times)), len(model.arm.links)
    )
    problem = AlignmentProblem(
        measurement_model(model), (SightedTrial("", motion, hand),)
    )
    names = problem.parameters((*REQUIRED_EFFECTS, *CANDIDATE_EFFECTS))
    low, high = problem.ranges(names)
    slope = problem.jacobian(
        names, np.array([TYPICAL_VALUES.get(name, 0.0) for name in names])
    ) * (high - low)
    clocks = np.linalg.pinv(np.delete(slope, names.index(LAG), axis=1))[
        names.index(OFFSET)
    ]
    return float(
        np.linalg.slogdet(slope.T @ slope)[1]
        - CLOCK_PARAMETERS * np.log(np.sum(clocks**2))
    )


def build_motion(arm: Arm, angles: np.ndarray, count: Counter[str]) -> Motion:
    """The artifact. angles: (K, J). There is no target, and the string's own motion is
    not predicted.
    """
    columns = {"t": np.arange(len(angles)) * arm.tick}
    columns |= dict(zip(JOINTS, angles.T, strict=True)) | dict(
        zip(SPEEDS, arm.commanded_velocities(angles).T, strict=True)
    )
    outcome = {c.name: [np.nan] for c in MOTION_OUTCOME.columns}
    outcome |= {
        "duration": [(len(angles) - 1) * arm.tick],
        "tried": [sum(count.values())],
    }
    return Motion(
        COMMANDS.check(pd.DataFrame(columns)),
        CONTROL_POINTS.empty(),
        PREDICTED_STRING.empty(),
        ATTEMPTS.check(
            pd.DataFrame(sorted(count.items()), columns=["outcome", "count"])
        ),
        MOTION_OUTCOME.check(pd.DataFrame(outcome)),
    )
