"""Faults of arm and grasp, and the path that the grasp takes with them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from stringcast.stages.model.arm import Arm

REST_S = 0.12  # rest before and after a motion, which wrong clocks read
SLIP_EDGE_S = 0.004  # duration of the onset and end of a slip
STICKING_EDGE_S = 0.003
RINGING_HZ = 12
RINGING_DAMPING = 0.1


class HandFaults(NamedTuple):
    """Faults of arm and grasp, each absent at zero."""

    lag: float = 0.0  # [s], lag of the joints
    gain: float = 0.0
    gap_1: float = 0.0  # [rad], play from end to end
    gap_2: float = 0.0
    gap_3: float = 0.0
    angle: float = 0.0  # [rad], string against the last link
    slip: float = 0.0  # [m/s], out of the gripper
    slip_from: float = 0.0  # [s]
    slip_until: float = 0.0
    # outside the library: the second joint sticks, is mounted askew or rings, its link
    # is longer, the base shakes
    sticking: float = 0.0  # [s]
    sticking_from: float = 0.0
    joint_offset: float = 0.0  # [rad]
    ringing: float = 0.0  # [s2], deflection over acceleration
    link_excess: float = 0.0  # [m]
    shaking: float = 0.0  # [m]
    shaking_direction: float = 0.0  # [rad]
    shaking_frequency: float = 8.0  # [Hz]


@dataclass(frozen=True)
class GraspPath:
    """Pose of the grasp as smooth functions of time.

    Parameters
    ----------
    start, end : time range [s]
    pose : spline to x [m], y [m] and theta [rad]
    """

    start: float
    end: float
    pose: BSpline

    @staticmethod
    def fit(t: np.ndarray, pose: np.ndarray) -> GraspPath:
        """Fit a quintic spline, at rest at both ends, to poses (K, 3) at times (K,)."""
        still = [(1, np.zeros(3)), (2, np.zeros(3))]
        spline = make_interp_spline(t, pose, k=5, bc_type=(still, still))
        return GraspPath(float(t[0]), float(t[-1]), spline)

    def states(self, t: np.ndarray) -> np.ndarray:
        """Return x, y, vx, vy, ax, ay, theta and omega at times (K,), (K, 8)."""
        pose = self.pose(t)
        rate = self.pose(t, nu=1)
        second_rate = self.pose(t, nu=2)
        parts = [pose[:, :2], rate[:, :2], second_rate[:, :2], pose[:, 2:], rate[:, 2:]]
        return np.concatenate(parts, axis=-1)


def grasp_path(
    arm: Arm, t: np.ndarray, angles: np.ndarray, faults: HandFaults
) -> GraspPath:
    """Return the path of the grasp when joints are driven through angles.

    Parameters
    ----------
    arm : the arm
    t : (K,) even times [s]
    angles : (K, J) angles [rad]
    faults : of arm and grasp
    """
    tick = t[1] - t[0]
    more = round(REST_S / tick)
    t = t[0] + tick * np.arange(-more, len(t) + more)
    angles = np.pad(angles, ((more, more), (0, 0)), mode="edge")
    links = np.array(arm.links) + faults.link_excess * np.array([0.0, 1.0, 0.0])
    theta = np.cumsum(actual_joint_angles(t, angles, faults), axis=1)
    string_angle = theta[:, -1] + faults.angle
    slid = slip_distance(t, faults)
    shaking = faults.shaking * np.sin(2 * np.pi * faults.shaking_frequency * t)
    shaking *= 1 - np.exp(-np.maximum(t - t[0], 0) / 0.05) ** 3
    direction = faults.shaking_direction
    x = arm.base[0] + np.cos(theta) @ links
    x = x + slid * np.cos(string_angle) + shaking * np.cos(direction)
    y = arm.base[1] + np.sin(theta) @ links
    y = y + slid * np.sin(string_angle) + shaking * np.sin(direction)
    return GraspPath.fit(t, np.stack([x, y, string_angle], axis=-1))


def actual_joint_angles(
    t: np.ndarray, angles: np.ndarray, faults: HandFaults
) -> np.ndarray:
    """Return the angles (K, J) that joints take when they are driven through others."""
    tick = t[1] - t[0]
    actual = angles[0] + (1 + faults.gain) * (angles - angles[0])
    if faults.lag:
        actual = _lagging(actual, np.exp(-tick / faults.lag))
    gaps = np.array([faults.gap_1, faults.gap_2, faults.gap_3])
    if gaps.any():
        actual = _with_play(actual, gaps / 2)
    second = actual[:, 1].copy()
    if faults.sticking:
        begin, end = faults.sticking_from, faults.sticking_from + faults.sticking
        rise = np.tanh((t - begin) / STICKING_EDGE_S)
        fall = np.tanh((t - end) / STICKING_EDGE_S)
        second -= 0.5 * (rise - fall) * (second - np.interp(begin, t, second))
    if faults.ringing:
        acceleration = np.gradient(np.gradient(second, tick), tick)
        second -= faults.ringing * _ringing_response(acceleration, tick)
    actual = actual.copy()
    actual[:, 1] = second + faults.joint_offset
    return actual


def _lagging(angles: np.ndarray, decay: float) -> np.ndarray:
    """Return a first-order lag, exact for angles that change evenly within a tick."""
    actual = angles.copy()
    rate = np.diff(angles, axis=0)
    steady = rate / -np.log(decay)  # distance by which a ramp is followed
    for k in range(len(rate)):
        behind = actual[k] - angles[k] + steady[k]
        actual[k + 1] = angles[k + 1] - steady[k] + decay * behind
    return actual


def _with_play(angles: np.ndarray, half_gap: np.ndarray) -> np.ndarray:
    """Return angles behind gears with play: a joint stays until it is pushed."""
    actual = angles.copy()
    for k in range(1, len(angles)):
        at_least, at_most = angles[k] - half_gap, angles[k] + half_gap
        actual[k] = np.minimum(np.maximum(actual[k - 1], at_least), at_most)
    return actual


def _ringing_response(acceleration: np.ndarray, tick: float) -> np.ndarray:
    """Return the response (K,) of a joint on a damped spring to an acceleration."""
    stiffness = (2 * np.pi * RINGING_HZ) ** 2
    damping = 2 * RINGING_DAMPING * 2 * np.pi * RINGING_HZ
    place = 0.0
    speed = 0.0
    response = np.zeros_like(acceleration)
    for k, push in enumerate(acceleration):
        speed += tick * (stiffness * (push - place) - damping * speed)
        place += tick * speed
        response[k] = place
    return response


def slip_distance(t: np.ndarray, faults: HandFaults) -> np.ndarray:
    """Return the distance (K,) by which the string has slid out of the gripper [m]."""

    def time_since(begin: float) -> np.ndarray:
        return SLIP_EDGE_S * np.logaddexp(0.0, (t - begin) / SLIP_EDGE_S)

    duration = time_since(faults.slip_from) - time_since(faults.slip_until)
    return np.asarray(faults.slip * duration)
