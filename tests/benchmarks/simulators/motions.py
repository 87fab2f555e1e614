"""Random casts: motions of the arm as it performs and reports them, and frame times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BPoly

from stringcast.hardware.virtual.servo import VirtualServo
from stringcast.stages.model.arm import Arm

REST_BEFORE_S = 0.05
REST_AFTER_S = 0.15
DURATION_RANGE_S = (0.45, 0.85)
MISSED_FRAMES = 0.02  # share of the pictures that are lost
SPEED_TOLERANCE = 1.1  # the fastest hand speed, over the one that is wanted


@dataclass(frozen=True, eq=False)
class Cast:
    """A performed motion, equal to itself alone.

    Parameters
    ----------
    t : (K,) times of the arm's log [s]
    reported : (K, J) joint angles that the encoders logged [rad]
    fine : (M,) even times [s]
    angles : (M, J) angles through which the joints were driven [rad]
    frames : (F,) times of the camera's pictures [s]
    """

    t: np.ndarray
    reported: np.ndarray
    fine: np.ndarray
    angles: np.ndarray
    frames: np.ndarray


def random_cast(arm: Arm, rng: np.random.Generator, fps: float, speed: float) -> Cast:
    """Draw a cast whose hand reaches about a speed, or the fastest that the arm can.

    Parameters
    ----------
    arm : the arm, whose limits the motion keeps
    rng : source of chance
    fps : frames per second of the camera
    speed : largest speed of the hand [m/s]

    Returns
    -------
    The cast; some of its pictures are missing.
    """
    while True:
        duration = float(np.round(rng.uniform(*DURATION_RANGE_S) / arm.tick) * arm.tick)
        first_tick = -round(REST_BEFORE_S / arm.tick)
        last_tick = round((duration + REST_AFTER_S) / arm.tick)
        ticks = np.arange(first_tick, last_tick + 1) * arm.tick
        progress = np.clip(ticks / duration, 0, 1)
        motion = MOTIONS[rng.integers(len(MOTIONS))]
        swing = motion(rng, progress, len(arm.links))
        start = rng.uniform(arm.lowest, arm.highest)
        # The lever of each joint changes with the angles, so the scale is iterated.
        for _ in range(3):
            swing = swing * speed / fastest_hand(arm, start + swing)
        angles = start + swing
        slow_enough = fastest_hand(arm, angles) < SPEED_TOLERANCE * speed
        if is_possible(arm, angles) and slow_enough:
            return perform(arm, ticks, angles, rng, fps)


def perform(
    arm: Arm,
    ticks: np.ndarray,
    angles: np.ndarray,
    rng: np.random.Generator,
    fps: float,
) -> Cast:
    """Perform commanded angles with a real servo, filmed from a random moment on.

    Parameters
    ----------
    arm : the arm
    ticks : (K,) times of the commands [s]
    angles : (K, J) commanded joint angles [rad]
    rng : source of chance
    fps : frames per second of the camera

    Returns
    -------
    The cast.
    """
    reported, fine, driven = drive(arm, ticks, angles, rng)
    first = ticks[0] + rng.uniform() / fps
    frames = first + np.arange(int((ticks[-1] - first) * fps) + 1) / fps
    kept = rng.uniform(size=len(frames)) > MISSED_FRAMES
    return Cast(ticks, reported, fine, driven, frames[kept])


def drive(
    arm: Arm, ticks: np.ndarray, angles: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Drive a real servo by commanded angles (K, J) [rad] at times (K,) [s].

    Returns the angles that the encoders report at these times, and even times with the
    true angles.
    """
    servo = VirtualServo()
    fine, turned = servo.follow_commands(ticks, arm.commanded_velocities(angles), rng)
    driven = angles[0] + turned
    at_ticks = np.stack([np.interp(ticks, fine, q) for q in driven.T], axis=-1)
    return servo.encoder_reading(at_ticks), fine, driven


def _bezier(rng: np.random.Generator, progress: np.ndarray, joints: int) -> np.ndarray:
    """Draw the paper's motion: joint speeds are Bezier curves of degree 5."""
    control = np.zeros((6, 1, joints))
    control[1:-1] = rng.uniform(-1, 1, (4, 1, joints))
    return np.asarray(BPoly(control, [0.0, 1.0]).antiderivative()(progress))


def _out_and_back(
    rng: np.random.Generator, progress: np.ndarray, joints: int
) -> np.ndarray:
    """Draw a move out, a rest, and a move part of the way back, with least jerk."""
    turn = rng.uniform(0.35, 0.55)
    returned = rng.uniform(-0.2, 1.0, joints)
    reach = rng.uniform(-1, 1, joints)
    out = _least_jerk(progress / turn)
    back = _least_jerk((progress - turn - 0.1) / (0.9 - turn))
    return out[:, None] * reach - back[:, None] * reach * returned


def _swing(rng: np.random.Generator, progress: np.ndarray, joints: int) -> np.ndarray:
    """Draw a wave that swells and fades, with another phase in each joint."""
    phase = rng.uniform(0, 2 * np.pi, joints)
    periods = rng.uniform(1.0, 2.0)
    amplitude = rng.uniform(0.3, 1.0, joints)
    envelope = np.sin(np.pi * progress) ** 3
    wave = np.sin(2 * np.pi * periods * progress[:, None] + phase)
    return envelope[:, None] * amplitude * wave


def _least_jerk(progress: np.ndarray) -> np.ndarray:
    x = np.clip(progress, 0, 1)
    return np.asarray(10 * x**3 - 15 * x**4 + 6 * x**5)


MOTIONS = (_bezier, _out_and_back, _swing)


def fastest_hand(arm: Arm, angles: np.ndarray) -> float:
    """Return the largest speed of the hand [m/s]."""
    steps = np.diff(arm.grasp_pose(angles)[:, :2], axis=0)
    return float(np.linalg.norm(steps, axis=1).max() / arm.tick)


def is_possible(arm: Arm, angles: np.ndarray) -> bool:
    """Check the arm's ranges, joint speeds and accelerations."""
    speeds = arm.commanded_velocities(angles)
    accelerations = np.abs(np.diff(speeds, axis=0)) / arm.tick
    within_range = (angles > arm.lowest).all() and (angles < arm.highest).all()
    within_speed = (np.abs(speeds) <= arm.speed).all()
    within_acceleration = (accelerations <= arm.acceleration).all()
    return bool(within_range and within_speed and within_acceleration)
