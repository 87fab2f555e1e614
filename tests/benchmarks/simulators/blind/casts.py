"""Random casts of the arm: smooth joint motions within its limits, as the arm performs
and reports them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BPoly

from stringcast.hardware.virtual.servo import VirtualServo
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.hand import JointMotion, resample_joint_motion

BEFORE, AFTER = 0.05, 0.1  # [s] of rest around the movement
FINE = 0.001  # [s]
DURATION = (0.35, 0.85)  # [s]


@dataclass(frozen=True)
class Cast:
    """One trial. t (K,), reported (K, J): log of the encoders on the arm's tick [s],
    [rad]. happened: the joints' motion. frames: (F,) times at which the camera has a
    picture [s].
    """

    t: np.ndarray
    reported: np.ndarray
    happened: JointMotion
    frames: np.ndarray


def random_cast(
    arm: Arm, rng: np.random.Generator, fps: float, speeds: tuple[float, float]
) -> Cast:
    """A cast whose hand reaches a speed between `speeds` [m/s], performed, with some
    pictures missing.
    """
    while True:
        duration = float(np.round(rng.uniform(*DURATION) / arm.tick) * arm.tick)
        # the paper's velocity curves (III): Bezier of degree 5, at rest at both ends
        control = np.zeros((6, 1, len(arm.links)))
        control[1:-1] = rng.uniform(-1, 1, (4, 1, len(arm.links)))
        curve = BPoly(control, [0.0, duration])
        start = rng.uniform(arm.lowest, arm.highest)
        inside = np.arange(round(duration / arm.tick) + 1) * arm.tick
        turned = curve.antiderivative()(np.clip(inside, 0.0, duration))
        hand = np.linalg.norm(
            arm.grasp_velocity(start + turned, curve(inside))[:, :2], axis=-1
        ).max()
        wanted = np.exp(rng.uniform(*np.log(speeds)))
        scale = wanted / hand  # roughly: the lever changes with the angles
        ticks = (
            np.arange(
                -round(BEFORE / arm.tick), round((duration + AFTER) / arm.tick) + 1
            )
            * arm.tick
        )
        angles = start + scale * curve.antiderivative()(np.clip(ticks, 0.0, duration))
        # within the arm's ranges, joint speeds and accelerations, and the hand about as
        # fast as wanted
        commanded = arm.commanded_velocities(angles)
        hand = np.linalg.norm(
            arm.grasp_velocity(angles, commanded)[:, :2], axis=-1
        ).max()
        inside = (angles > arm.lowest).all() and (angles < arm.highest).all()
        changes = np.abs(np.diff(commanded, axis=0)) / arm.tick
        gentle = (np.abs(commanded) <= arm.speed).all() and (
            changes <= arm.acceleration
        ).all()
        if (
            inside
            and gentle
            and 0.8 * speeds[0] <= hand <= min(1.2 * speeds[1], arm.hand_speed)
        ):
            return performed(arm, ticks, angles, rng, fps)


def performed(
    arm: Arm,
    ticks: np.ndarray,
    angles: np.ndarray,
    rng: np.random.Generator,
    fps: float,
) -> Cast:
    """A movement as this arm makes it, filmed. ticks: (K,) [s]. angles: (K, J) that it
    is commanded to go to [rad].
    """
    servo = VirtualServo()
    fine, turned = servo.follow_commands(ticks, arm.commanded_velocities(angles), rng)
    happened = angles[0] + turned
    at_ticks = np.stack([np.interp(ticks, fine, q) for q in happened.T], axis=-1)
    frames = (
        np.arange(np.ceil(ticks[0] * fps - 1e-6), np.floor(ticks[-1] * fps + 1e-6) + 1)
        / fps
    )
    kept = rng.uniform(size=len(frames)) > 0.02
    return Cast(
        ticks,
        servo.encoder_reading(at_ticks),
        resample_joint_motion(fine, happened, FINE),
        frames[kept],
    )
