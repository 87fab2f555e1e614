"""The hand's motion: from what the arm reports to the pose of the grasp."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from stringcast.data.lazy_module import LazyModule
from stringcast.data.schema import DataError
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.effect import HandEffect

interpolate = LazyModule("scipy.interpolate")

# The control period in the paper.
HAND_TICK_S = 0.005
# Every lag has decayed after this rest. A film may continue for much longer.
MAX_LAG_S = 0.5
# An effect and its parameters, (C, 1, 1) each.
HandEffectValues = tuple[type[HandEffect], Mapping[str, np.ndarray]]
ValueAndRate = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class HandMotion:
    """Poses of the grasp on a uniform tick, cubic Hermite between.

    Parameters
    ----------
    start : float
        Time of the first pose [s].
    tick : float
        Period [s].
    pose : ndarray of shape (B, K, 3)
        x [m], y [m] and theta [rad], which is continuous. B is the number of motions: 1
        (shared by all candidates) or one for each candidate.
    rate : ndarray of shape (B, K, 3)
        Its time derivative.
    """

    start: float
    tick: float
    pose: np.ndarray
    rate: np.ndarray

    @property
    def times(self) -> np.ndarray:
        """Times of the poses, (K,) [s]."""
        return self.start + self.tick * np.arange(self.tick_count)

    @property
    def tick_count(self) -> int:
        """Number of the poses, K."""
        return int(self.pose.shape[1])

    @property
    def end(self) -> float:
        """Time of the last pose [s]."""
        return float(self.times[-1])

    def for_candidates(self, chosen: np.ndarray) -> HandMotion:
        """Return the motions of some candidates, by number, or the shared motion."""
        if len(self.pose) == 1:
            return self
        return replace(self, pose=self.pose[chosen], rate=self.rate[chosen])

    def with_ticks(self, count: int) -> HandMotion:
        """Cut the motion to `count` poses, or append rest."""
        missing = max(count - self.tick_count, 0)
        pose, rate = append_rest_ticks(
            self.pose[:, :count], self.rate[:, :count], missing
        )
        return replace(self, pose=pose, rate=rate)

    def extended_until(self, until: float) -> HandMotion:
        """Append rest until a time [s], for `MAX_LAG_S` at most."""
        missing = _rest_ticks(until - self.end, self.tick)
        return self.with_ticks(self.tick_count + missing)

    def starting_at(self, begin: float | np.ndarray) -> HandMotion:
        """Return the motion from a time on, with that time as its zero.

        The hand rests before its first pose and after its last.

        Parameters
        ----------
        begin : float or ndarray of shape (C,)
            The time [s], or one for each candidate.
        """
        if np.ndim(begin) > 0:
            return self._read_from(np.asarray(begin))
        moment = float(begin)
        if moment not in self._motions_by_begin:
            motion = self._read_from(np.array([moment]))
            self._motions_by_begin[moment] = replace(motion, start=moment)
        return self._motions_by_begin[moment]

    def _read_from(self, begin: np.ndarray) -> HandMotion:
        """Return the motion from a time of each candidate on, (1 or C,) [s]."""
        remaining = (self.end - np.min(begin)) / self.tick
        count = max(int(np.ceil(remaining - 1e-9)), 1) + 1
        first = (np.reshape(begin, (-1, 1)) - self.start) / self.tick
        ticks = first + np.arange(count)  # (C, count), relative to the known poses
        last = self.tick_count - 1
        place = np.clip(ticks, 0, last)
        before = np.minimum(place.astype(int), last - 1)
        offset = (place - before)[..., None]
        row = np.arange(len(self.pose))[:, None]
        pose_cubics, rate_parabolas = self._polynomials
        pose = np.polyval(pose_cubics[:, before, row], offset)
        rate = np.polyval(rate_parabolas[:, before, row], offset)
        is_moving = (ticks == place)[..., None]
        rate = np.where(is_moving, rate / self.tick, 0.0)
        return HandMotion(0.0, self.tick, pose, rate)

    @cached_property
    def _motions_by_begin(self) -> dict[float, HandMotion]:
        """Cache of motions from a time on: a fit uses the same ones again."""
        return {}

    @cached_property
    def _polynomials(self) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients of poses and of rates between ticks, (4 or 3, K - 1, C, 3)."""
        ticks = np.arange(self.tick_count)
        rate_per_tick = self.rate * self.tick
        spline = interpolate.CubicHermiteSpline(ticks, self.pose, rate_per_tick, axis=1)
        return spline.c, spline.derivative().c

    def actual_hand_motion(
        self, arm: Arm, effects: Sequence[HandEffectValues]
    ) -> HandMotion:
        """Apply effects on the grasp, one motion for all candidates or one each.

        Raises DataError if an effect needs joint angles.
        """
        motion = self
        for effect, parameters in effects:
            if "grasp" not in effect.laws():
                raise DataError(
                    "",
                    f"effect '{effect.name}' acts on joint angles, but this "
                    "trial has only poses of the grasp",
                    "Add arm.parquet, or leave the effect out.",
                )
            pose, rate = _apply_law(
                effect, "grasp", motion, motion.pose, motion.rate, parameters
            )
            motion = HandMotion(self.start, self.tick, pose, rate)
        return motion


@dataclass(frozen=True)
class JointMotion:
    """Joint angles on a uniform tick.

    Parameters
    ----------
    start, tick : float
        As in `HandMotion` [s].
    angles, speeds : ndarray of shape (B, K, J)
        Joint angles [rad] and speeds [rad/s].
    """

    start: float
    tick: float
    angles: np.ndarray
    speeds: np.ndarray

    @property
    def times(self) -> np.ndarray:
        """Times of the angles, (K,) [s]."""
        return self.start + self.tick * np.arange(self.angles.shape[1])

    def extended_until(self, until: float) -> JointMotion:
        """Append rest until a time [s], for `MAX_LAG_S` at most."""
        missing = _rest_ticks(until - self.times[-1], self.tick)
        angles, speeds = append_rest_ticks(self.angles, self.speeds, missing)
        return JointMotion(self.start, self.tick, angles, speeds)

    def hand_motion(self, arm: Arm) -> HandMotion:
        """Return the hand's motion by an arm's forward kinematics."""
        pose, rate = arm.grasp_pose_and_velocity(self.angles, self.speeds)
        return HandMotion(self.start, self.tick, pose, rate)

    def actual_joint_motion(self, effects: Sequence[HandEffectValues]) -> JointMotion:
        """Apply effects on the joints, one motion for all candidates or one each."""
        motion = self
        for effect, parameters in effects:
            if "joints" in effect.laws():
                angles, speeds = _apply_law(
                    effect, "joints", motion, motion.angles, motion.speeds, parameters
                )
                motion = JointMotion(self.start, self.tick, angles, speeds)
        return motion

    def actual_hand_motion(
        self, arm: Arm, effects: Sequence[HandEffectValues]
    ) -> HandMotion:
        """Apply effects on the joints, then those on the grasp."""
        hand = self.actual_joint_motion(effects).hand_motion(arm)
        grasp_effects = [
            values for values in effects if "joints" not in values[0].laws()
        ]
        return hand.actual_hand_motion(arm, grasp_effects)


def resample_joint_motion(
    t: np.ndarray, angles: np.ndarray, tick: float = HAND_TICK_S
) -> JointMotion:
    """Put joint angles on a uniform tick, by natural cubic splines between samples.

    Parameters
    ----------
    t : ndarray of shape (K,)
        Increasing times [s].
    angles : ndarray of shape (K, J) or (B, K, J)
        Joint angles [rad].
    tick : float
        Period of the result [s].
    """
    batch = angles if angles.ndim == 3 else angles[None]
    return JointMotion(*_resample(t, batch, tick))


def resample_hand_motion(
    t: np.ndarray, pose: np.ndarray, tick: float = HAND_TICK_S
) -> HandMotion:
    """Put grasp poses on a uniform tick, by natural cubic splines between samples.

    Parameters
    ----------
    t : ndarray of shape (K,)
        Increasing times [s].
    pose : ndarray of shape (K, 3) or (B, K, 3)
        Poses of the grasp [m], [m], [rad]; theta is unwrapped here.
    tick : float
        Period of the result [s].
    """
    batch = np.array(pose if pose.ndim == 3 else pose[None], dtype=float)
    batch[..., 2] = np.unwrap(batch[..., 2], axis=1)
    return HandMotion(*_resample(t, batch, tick))


def _resample(
    t: np.ndarray, values: np.ndarray, tick: float
) -> tuple[float, float, np.ndarray, np.ndarray]:
    """Return start, tick, values and rates, from first to last sample.

    There are at least two values, (B, K, ...).
    """
    ticks = np.floor((t[-1] - t[0]) / tick + 1e-9)
    count = max(int(ticks) + 1, 2)
    times = t[0] + tick * np.arange(count)
    spline = interpolate.CubicSpline(t, values, axis=1, bc_type="natural")
    return float(times[0]), tick, spline(times), spline(times, 1)


def _rest_ticks(seconds: float, tick: float) -> int:
    """Count the ticks in further seconds, at most `MAX_LAG_S`."""
    ticks = np.clip(seconds, 0.0, MAX_LAG_S) / tick
    return int(np.ceil(ticks - 1e-9))


def append_rest_ticks(value: np.ndarray, rate: np.ndarray, count: int) -> ValueAndRate:
    """Append ticks of rest to value and rate, (B, K, ...) each."""
    held = value[:, -1:].repeat(count, axis=1)
    still = np.zeros_like(rate[:, -1:]).repeat(count, axis=1)
    values = np.concatenate([value, held], axis=1)
    return values, np.concatenate([rate, still], axis=1)


def _apply_law(
    effect: type[HandEffect],
    law: str,
    motion: HandMotion | JointMotion,
    value: np.ndarray,
    rate: np.ndarray,
    parameters: Mapping[str, np.ndarray],
) -> ValueAndRate:
    """Apply a law to value and rate, (B, K, ...) each.

    Candidates without the effect are skipped. A cubic spline through the change of the
    value gives the change of the rate.
    """
    differs = [parameters[p.name].ravel() != p.start for p in effect.parameters]
    present = np.any(differs, axis=0)
    if not present.any():
        return value, rate
    t = motion.times
    before = value if len(value) == 1 else value[present]
    sizes = {name: p[present] for name, p in parameters.items()}
    change = effect.laws()[law](t, before, **sizes) - before
    shape = (len(present), *value.shape[1:])
    values = np.broadcast_to(value, shape).copy()
    rates = np.broadcast_to(rate, shape).copy()
    values[present] += change
    spline = interpolate.CubicSpline(t, change, axis=1, bc_type="natural")
    rates[present] += spline(t, 1)
    return values, rates
