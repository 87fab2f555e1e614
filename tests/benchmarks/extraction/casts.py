"""Random casts to be filmed, so that recorded results can be repeated from a seed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BPoly

from stringcast.stages.model.arm import Arm
from stringcast.stages.model.hand import JointMotion, resample_joint_motion
from tests.benchmarks.simulators.motions import drive, is_possible

REST_BEFORE_S = 0.05
REST_AFTER_S = 0.1
DURATION_RANGE_S = (0.35, 0.85)
MOTION_TICK_S = 0.001
MISSED_FRAMES = 0.02  # share of the pictures that are lost
HAND_SPEEDS_M_S = (1.5, 4.0)  # tips reach about three times that


@dataclass(frozen=True)
class FilmedCast:
    """A performed motion.

    Parameters
    ----------
    t : (K,) times of the arm's log [s]
    reported : (K, J) joint angles that the encoders logged [rad]
    motion : the true motion of the joints
    frames : (F,) times of the camera's pictures [s]
    """

    t: np.ndarray
    reported: np.ndarray
    motion: JointMotion
    frames: np.ndarray


def draw_cast(arm: Arm, rng: np.random.Generator, fps: float) -> FilmedCast:
    """Draw a motion with the paper's velocity curves within the limits of the arm."""
    while True:
        duration = float(np.round(rng.uniform(*DURATION_RANGE_S) / arm.tick) * arm.tick)
        control = np.zeros((6, 1, len(arm.links)))
        control[1:-1] = rng.uniform(-1, 1, (4, 1, len(arm.links)))
        velocity = BPoly(control, [0.0, duration])
        turned = velocity.antiderivative()
        start = rng.uniform(arm.lowest, arm.highest)
        times = np.arange(round(duration / arm.tick) + 1) * arm.tick
        angles = start + turned(np.clip(times, 0.0, duration))
        # the lever of each joint changes with the angles, so this scale is rough
        speed = np.exp(rng.uniform(*np.log(HAND_SPEEDS_M_S)))
        scale = speed / _fastest_hand(arm, angles, velocity(times))

        first_tick = -round(REST_BEFORE_S / arm.tick)
        last_tick = round((duration + REST_AFTER_S) / arm.tick)
        ticks = np.arange(first_tick, last_tick + 1) * arm.tick
        angles = start + scale * turned(np.clip(ticks, 0.0, duration))
        if _is_castable(arm, angles):
            return perform(arm, ticks, angles, rng, fps)


def perform(
    arm: Arm,
    ticks: np.ndarray,
    angles: np.ndarray,
    rng: np.random.Generator,
    fps: float,
) -> FilmedCast:
    """Perform commanded angles (K, J) [rad] at times (K,) [s] with a real servo."""
    reported, fine, driven = drive(arm, ticks, angles, rng)
    first_frame = np.ceil(ticks[0] * fps - 1e-6)
    last_frame = np.floor(ticks[-1] * fps + 1e-6)
    frames = np.arange(first_frame, last_frame + 1) / fps
    kept = rng.uniform(size=len(frames)) > MISSED_FRAMES
    motion = resample_joint_motion(fine, driven, MOTION_TICK_S)
    return FilmedCast(ticks, reported, motion, frames[kept])


def _fastest_hand(arm: Arm, angles: np.ndarray, velocities: np.ndarray) -> float:
    """Return the largest speed of the hand [m/s]."""
    velocity = arm.grasp_velocity(angles, velocities)[:, :2]
    return float(np.linalg.norm(velocity, axis=-1).max())


def _is_castable(arm: Arm, angles: np.ndarray) -> bool:
    """Return whether a motion keeps the arm's limits at about the wanted hand speed."""
    hand = _fastest_hand(arm, angles, arm.commanded_velocities(angles))
    low, high = HAND_SPEEDS_M_S
    has_speed = 0.8 * low <= hand <= min(1.2 * high, arm.hand_speed)
    return has_speed and is_possible(arm, angles)
