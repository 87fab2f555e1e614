"""Excite: choose a slow motion from which camera and clock are measured.

Each joint swings by a sum of sines that starts and ends at rest. The motion with the
largest information among many drawn ones is taken (D-optimality), with extra weight on
the clock offset. Several frequencies distinguish an arm lag, which attenuates the high
ones, from a clock offset.

References
----------
Swevers et al., "Optimal robot excitation and identification", 1997.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Annotated

import numpy as np
import pandas as pd
from pydantic import Field, PositiveFloat, PositiveInt

from stringcast.data.artifacts import (
    ATTEMPTS,
    COMMANDS,
    CONTROL_POINTS,
    JOINTS,
    PREDICTED_STRING,
    SPEEDS,
    Motion,
    outcome_without_target,
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
PICTURE_MARGIN = 0.03  # free margin around the arm, as a share of the picture's width
# extra weight: undetected effects, such as a faint rolling shutter, bias the offset
CLOCK_WEIGHT = 2
# values at which the design is evaluated; a lag of zero would look like an offset
TYPICAL_VALUES = {LAG: 0.005}
MAX_DRAWS_RATIO = 25  # draws over configured draws, until a motion is allowed
SIGHTING_INTERVAL_S = 0.01  # at which the design is evaluated


def run(call: StageCall) -> Motion:
    """Choose the motion for a run's model and obstacles."""
    return call.by(
        call.setup.model, call.setup.obstacles, seed=call.seed, progress=call.progress
    )


def excite(
    model: Model,
    obstacles: Sequence[Box],
    *,
    seed: int,
    duration: Annotated[float, Field(gt=0.5, le=60)],
    speed: PositiveFloat,
    highest: PositiveFloat,
    sines: PositiveInt,
    motions: PositiveInt,
    progress: Progress = lambda share: None,
) -> Motion:
    """Draw motions and return the most informative one.

    The hand stays a string's length away from obstacles.

    Parameters
    ----------
    model
        The model of arm, string and camera.
    obstacles
        Boxes to avoid.
    seed
        Seed of the random draws.
    duration
        Duration of the motion [s].
    speed
        Largest speed of the hand [m/s].
    highest
        Largest frequency of a sine [Hz].
    sines
        Number of sines of each joint.
    motions
        Number of motions to draw; more are drawn until one is allowed.
    progress
        Called with the completed share.

    Returns
    -------
    Motion
        The motion, without a target.

    Raises
    ------
    DataError
        If no drawn motion is allowed, or no sine fits into the duration.
    """
    if highest * duration < 1:
        raise DataError(
            "",
            f"one period of excite.highest={highest:g} Hz (conf/excite) is "
            f"longer than excite.duration={duration:g} s",
            "Raise one of them.",
        )
    rng = np.random.default_rng(seed)
    outcomes: Counter[str] = Counter()
    best, best_information = None, -np.inf
    for number in range(MAX_DRAWS_RATIO * motions):
        if number >= motions and best is not None:
            break
        angles, speeds = draw_swings(model.arm, rng, duration, speed, highest, sines)
        violation = violated_limit(model, obstacles, angles, speeds)
        outcomes[violation or "allowed"] += 1
        if not violation:
            information = alignment_information(model, angles, speeds)
            if information > best_information:
                best, best_information = angles, information
        progress(min((number + 1) / motions, 1.0))
    if best is None:
        counts = [f"{reason}: {count}" for reason, count in outcomes.most_common()]
        raise DataError(
            "",
            f"no motion of {outcomes.total()} is allowed ({'; '.join(counts)})",
            "Lower excite.speed, raise excite.motions, or move the obstacles.",
        )
    return build_motion(model.arm, best, outcomes)


def draw_swings(
    arm: Arm,
    rng: np.random.Generator,
    duration: float,
    speed: float,
    highest: float,
    sines: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Draw swings about a random pose; return angles and speeds at ticks (K, J).

    The hand's largest speed is `speed`. Other parameters are those of `excite`.
    """
    t = np.arange(round(duration / arm.tick) + 1) * arm.tick
    low, high = np.asarray(arm.lowest), np.asarray(arm.highest)
    middle = (low + high) / 2 + rng.uniform(-0.3, 0.3, len(low)) * (high - low)
    frequency = rng.uniform(1 / duration, highest, (sines, len(low)))
    phase = rng.uniform(0, 2 * np.pi, frequency.shape)
    amplitude = rng.uniform(0.3, 1, frequency.shape) / frequency
    waves = np.sin(2 * np.pi * frequency * t[:, None, None] + phase)
    swing = np.sum(amplitude * waves, axis=1) * rise_and_fade(t / t[-1])[:, None]
    rate = np.gradient(swing, arm.tick, axis=0)
    scale = largest_scale(arm, middle, swing, rate, speed)
    return middle + scale * swing, scale * rate


def rise_and_fade(share: np.ndarray) -> np.ndarray:
    """Rise from 0 to 1 and fade to 0 over shares of the time (K,).

    The second derivative is continuous.
    """
    x = np.clip(np.minimum(share, 1 - share) / RAMP_FRACTION, 0, 1)
    return x**3 * (10 - 15 * x + 6 * x**2)


def largest_scale(
    arm: Arm, middle: np.ndarray, swing: np.ndarray, rate: np.ndarray, speed: float
) -> float:
    """Find the largest scale of a swing with which the hand never exceeds `speed`.

    middle: pose about which the joints swing (J,) [rad]. swing, rate: (K, J) [rad],
    [rad/s].
    """

    def hand_speed(scale: float) -> float:
        velocity = arm.grasp_velocity(middle + scale * swing, scale * rate)[:, :2]
        return float(np.linalg.norm(velocity, axis=-1).max())

    scale = 1.0
    for _ in range(3):  # the Jacobian changes with the angles
        scale *= 0.99 * speed / hand_speed(scale)
    while hand_speed(scale) > speed:
        scale *= 0.99
    return scale


def violated_limit(
    model: Model, obstacles: Sequence[Box], angles: np.ndarray, speeds: np.ndarray
) -> str:
    """Name the limit that a motion (K, J) violates; empty if none."""
    arm, camera = model.arm, model.camera
    fault = str(arm_faults(arm, obstacles, angles[None], speeds[None])[0])
    if fault:
        return fault
    joints = arm.joint_positions(angles)
    for box in obstacles:
        if any(box.distance_to(x, y) < model.string.length for x, y in joints[::4, -1]):
            return "the string could touch an obstacle"
    margin = PICTURE_MARGIN * camera.width
    pixels = camera.pixels(joints[:, 1:])
    last = np.array([camera.width, camera.height]) - 1
    is_inside = (pixels >= margin) & (pixels <= last - margin)
    return "" if is_inside.all() else "the arm leaves the picture"


def alignment_information(
    model: Model, angles: np.ndarray, speeds: np.ndarray
) -> float:
    """Compute the log information of a motion (K, J) about the alignment.

    It is the log determinant of the Fisher information of all parameters, plus
    CLOCK_WEIGHT times the log information about the clock offset with all others
    unknown. A lag is left out there, because only its sum with the offset is measured.
    """
    arm = model.arm
    motion = JointMotion(0.0, arm.tick, angles[None], speeds[None])
    times = np.arange(0, (len(angles) - 1) * arm.tick, SIGHTING_INTERVAL_S)
    # the Jacobian does not depend on the seen positions
    places, sigma = np.zeros((len(times), 2)), np.ones(len(times))
    hand = hand_sightings(times, places, sigma, len(arm.links))
    trial = SightedTrial("", motion, hand)
    problem = AlignmentProblem(measurement_model(model), (trial,))
    names = problem.parameters((*REQUIRED_EFFECTS, *CANDIDATE_EFFECTS))
    low, high = problem.ranges(names)
    values = np.array([TYPICAL_VALUES.get(name, 0.0) for name in names])
    jacobian = problem.jacobian(names, values) * (high - low)
    without_lag = np.delete(jacobian, names.index(LAG), axis=1)
    clock = np.linalg.pinv(without_lag)[names.index(OFFSET)]
    log_determinant = np.linalg.slogdet(jacobian.T @ jacobian)[1]
    return float(log_determinant - CLOCK_WEIGHT * np.log(np.sum(clock**2)))


def build_motion(arm: Arm, angles: np.ndarray, outcomes: Counter[str]) -> Motion:
    """Build the artifact of angles (K, J), without a target and a predicted string."""
    columns = {"t": np.arange(len(angles)) * arm.tick}
    columns |= dict(zip(JOINTS, angles.T, strict=True))
    columns |= dict(zip(SPEEDS, arm.commanded_velocities(angles).T, strict=True))
    attempts = pd.DataFrame(sorted(outcomes.items()), columns=["outcome", "count"])
    return Motion(
        COMMANDS.check(pd.DataFrame(columns)),
        CONTROL_POINTS.empty(),
        PREDICTED_STRING.empty(),
        ATTEMPTS.check(attempts),
        outcome_without_target((len(angles) - 1) * arm.tick, outcomes.total()),
    )
