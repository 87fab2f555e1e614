"""The hand as it really moves: faults of arm and grasp, absent at zero, and the way
that the grasp then takes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from stringcast.stages.model.arm import Arm

# [s] of rest added before and after, that clocks which are off may look into
REST = 0.12
EDGE = 0.004  # [s] within which a slip begins and ends


class Hand(NamedTuple):
    """Faults of arm and grasp, each absent at zero."""

    lag: float = 0.0  # [s], by which joints follow
    gain: float = 0.0
    gap_1: float = 0.0  # [rad] of play, end to end
    gap_2: float = 0.0
    gap_3: float = 0.0
    angle: float = 0.0  # [rad] of the string against the last link
    slip: float = 0.0  # [m/s], out of the gripper
    slip_from: float = 0.0
    slip_until: float = 0.0
    # outside the library: the second joint sticks, is mounted askew, rings; its link is
    # longer; the base shakes
    stick: float = 0.0  # [s]
    stick_from: float = 0.0
    askew: float = 0.0  # [rad]
    ringing: float = 0.0  # [s2], of deflection for acceleration
    link: float = 0.0  # [m]
    shake: float = 0.0  # [m]
    shake_towards: float = 0.0
    shake_frequency: float = 8.0  # [Hz]


@dataclass(frozen=True)
class Path:
    """Position and direction of the grasp as smooth functions of time. pose: spline to
    x, y [m], theta [rad].
    """

    start: float
    end: float
    pose: BSpline

    @staticmethod
    def through(t: np.ndarray, pose: np.ndarray) -> Path:
        """A quintic spline, at rest at both ends, through poses (K, 3) at times (K,)
        [s].
        """
        still = [(1, np.zeros(3)), (2, np.zeros(3))]
        return Path(
            float(t[0]),
            float(t[-1]),
            make_interp_spline(t, pose, k=5, bc_type=(still, still)),
        )

    def at(self, t: np.ndarray) -> np.ndarray:
        """x, y, their rates and second rates, theta and its rate, (K, 8)."""
        value, first, second = (self.pose(t, nu=nu) for nu in range(3))
        return np.concatenate(
            [value[:, :2], first[:, :2], second[:, :2], value[:, 2:], first[:, 2:]],
            axis=-1,
        )


def path(arm: Arm, t: np.ndarray, angles: np.ndarray, hand: Hand) -> Path:
    """The way of the grasp when joints are driven through angles (K, J) [rad] at even
    times (K,) [s].
    """
    tick = t[1] - t[0]
    more = round(REST / tick)
    t = t[0] + tick * np.arange(-more, len(t) + more)
    turned = driven(t, np.pad(angles, ((more, more), (0, 0)), mode="edge"), hand)
    links = np.array(arm.links) + hand.link * np.array([0.0, 1.0, 0.0])
    theta = np.cumsum(turned, axis=1)
    x, y = (
        base + wave(theta) @ links
        for base, wave in zip(arm.base, (np.cos, np.sin), strict=True)
    )
    along = theta[:, -1] + hand.angle
    way = slid(t, hand)
    swing = (
        hand.shake
        * np.sin(2 * np.pi * hand.shake_frequency * t)
        * (1 - np.exp(-np.maximum(t - t[0], 0) / 0.05) ** 3)
    )
    x = x + way * np.cos(along) + swing * np.cos(hand.shake_towards)
    y = y + way * np.sin(along) + swing * np.sin(hand.shake_towards)
    return Path.through(t, np.stack([x, y, along], axis=-1))


def driven(t: np.ndarray, angles: np.ndarray, hand: Hand) -> np.ndarray:
    """Angles (K, J) [rad] that joints really have when they are driven through others."""
    tick = t[1] - t[0]
    real = angles[0] + (1 + hand.gain) * (angles - angles[0])
    if hand.lag:
        real = lagging(real, np.exp(-tick / hand.lag))
    gaps = np.array([hand.gap_1, hand.gap_2, hand.gap_3])
    if gaps.any():
        real = played(real, gaps / 2)
    second = real[:, 1].copy()
    if hand.stick:
        stuck = 0.5 * (
            np.tanh((t - hand.stick_from) / 0.003)
            - np.tanh((t - hand.stick_from - hand.stick) / 0.003)
        )
        second -= stuck * (second - np.interp(hand.stick_from, t, second))
    if hand.ringing:
        second -= hand.ringing * ringing(
            np.gradient(np.gradient(second, tick), tick), tick
        )
    real = real.copy()
    real[:, 1] = second + hand.askew
    return real


def lagging(angles: np.ndarray, decay: float) -> np.ndarray:
    """A first-order lag, exact for angles that change evenly in a tick. decay: of a
    difference in a tick.
    """
    real, rate = angles.copy(), np.diff(angles, axis=0)
    steady = rate / -np.log(decay)  # by which a ramp is followed late
    for k in range(len(rate)):
        real[k + 1] = (
            angles[k + 1] - steady[k] + decay * (real[k] - angles[k] + steady[k])
        )
    return real


def played(angles: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Gears with play: a joint stays until it is pushed at the end of its gap."""
    real = angles.copy()
    for k in range(1, len(angles)):
        real[k] = np.minimum(
            np.maximum(real[k - 1], angles[k] - half), angles[k] + half
        )
    return real


def ringing(acceleration: np.ndarray, tick: float) -> np.ndarray:
    """Response (K,) of a joint on a spring, an oscillator of 12 Hz damped by a tenth,
    to an acceleration (K,).
    """
    pull, damp = (2 * np.pi * 12) ** 2, 2 * 0.1 * 2 * np.pi * 12
    place, speed, all_places = 0.0, 0.0, np.zeros_like(acceleration)
    for k, push in enumerate(acceleration):
        speed += tick * (pull * (push - place) - damp * speed)
        place += tick * speed
        all_places[k] = place
    return all_places


def slid(t: np.ndarray, hand: Hand) -> np.ndarray:
    """Distances by which the string has slid out of the gripper, (K,) [m]."""

    def since(begin: float) -> np.ndarray:
        return EDGE * np.logaddexp(0.0, (t - begin) / EDGE)

    return np.asarray(hand.slip * (since(hand.slip_from) - since(hand.slip_until)))
