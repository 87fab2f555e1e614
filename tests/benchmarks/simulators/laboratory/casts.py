"""Varied motions of the arm, as it performs and reports them, and clocks of cameras
that go their own way.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BPoly

from stringcast.hardware.virtual.servo import VirtualServo
from stringcast.stages.model.arm import Arm
from tests.benchmarks.simulators.laboratory.scene import Cast

BEFORE, AFTER = 0.05, 0.15  # [s] of rest around the movement
MISSED = 0.02  # of the pictures
BINDS = 1.1  # of the speed asked for


def random_cast(arm: Arm, rng: np.random.Generator, fps: float, speed: float) -> Cast:
    """A cast whose hand reaches about `speed` [m/s] at most, or as fast as the arm can;
    some pictures are missing.
    """
    while True:
        duration = float(np.round(rng.uniform(0.45, 0.85) / arm.tick) * arm.tick)
        ticks = (
            np.arange(
                -round(BEFORE / arm.tick), round((duration + AFTER) / arm.tick) + 1
            )
            * arm.tick
        )
        way = MOTIONS[rng.integers(len(MOTIONS))](
            rng, np.clip(ticks / duration, 0, 1), len(arm.links)
        )
        start = rng.uniform(arm.lowest, arm.highest)
        for _ in range(3):  # the lever changes with the angles
            way = way * speed / _fastest(arm, start + way)
        angles = start + way
        if _possible(arm, angles) and _fastest(arm, angles) < BINDS * speed:
            return _performed(arm, ticks, angles, rng, fps)


def _bezier(rng: np.random.Generator, share: np.ndarray, joints: int) -> np.ndarray:
    """The paper's: speeds by Bezier curves of degree 5."""
    control = np.zeros((6, 1, joints))
    control[1:-1] = rng.uniform(-1, 1, (4, 1, joints))
    return np.asarray(BPoly(control, [0.0, 1.0]).antiderivative()(share)[:, :])


def _to_and_fro(rng: np.random.Generator, share: np.ndarray, joints: int) -> np.ndarray:
    """Out, a rest, and part of the way back, each with the least jerk."""
    turn, back = rng.uniform(0.35, 0.55), rng.uniform(-0.2, 1.0, joints)
    out = rng.uniform(-1, 1, joints)
    return (
        _least_jerk(share / turn)[:, None] * out
        - _least_jerk((share - turn - 0.1) / (0.9 - turn))[:, None] * out * back
    )


def _swing(rng: np.random.Generator, share: np.ndarray, joints: int) -> np.ndarray:
    """A wave that swells and fades, of another phase in each joint."""
    phase, turns = rng.uniform(0, 2 * np.pi, joints), rng.uniform(1.0, 2.0)
    size = rng.uniform(0.3, 1.0, joints)
    return (
        (np.sin(np.pi * share) ** 3)[:, None]
        * size
        * np.sin(2 * np.pi * turns * share[:, None] + phase)
    )


def _least_jerk(share: np.ndarray) -> np.ndarray:
    x = np.clip(share, 0, 1)
    return np.asarray(10 * x**3 - 15 * x**4 + 6 * x**5)


MOTIONS = (_bezier, _to_and_fro, _swing)


def _fastest(arm: Arm, angles: np.ndarray) -> float:
    """The largest speed of the hand [m/s]."""
    return float(
        np.linalg.norm(np.diff(arm.grasp_pose(angles)[:, :2], axis=0), axis=1).max()
        / arm.tick
    )


def _possible(arm: Arm, angles: np.ndarray) -> bool:
    """Whether angles stay within the arm's ranges, joint speeds and accelerations."""
    commanded = arm.commanded_velocities(angles)
    return bool(
        (angles > arm.lowest).all()
        and (angles < arm.highest).all()
        and (np.abs(commanded) <= arm.speed).all()
        and (np.abs(np.diff(commanded, axis=0)) / arm.tick <= arm.acceleration).all()
    )


def _performed(
    arm: Arm,
    ticks: np.ndarray,
    angles: np.ndarray,
    rng: np.random.Generator,
    fps: float,
) -> Cast:
    """A movement as the arm makes it, filmed by a camera whose frames begin anywhere."""
    servo = VirtualServo()
    fine, turned = servo.follow_commands(ticks, arm.commanded_velocities(angles), rng)
    happened = angles[0] + turned
    reported = np.stack([np.interp(ticks, fine, q) for q in happened.T], axis=-1)
    first = ticks[0] + rng.uniform() / fps
    frames = first + np.arange(int((ticks[-1] - first) * fps) + 1) / fps
    kept = rng.uniform(size=len(frames)) > MISSED
    return Cast(ticks, servo.encoder_reading(reported), fine, happened, frames[kept])
