"""The hand's motion: from what the arm reports to the pose of the grasp, as the string
engine consumes it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from stringcast.data.lazy_module import LazyModule
from stringcast.data.schema import DataError
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.effect import HandEffect

interpolate = LazyModule("scipy.interpolate")

# [s] between samples of the hand's motion: the paper's control period
HAND_TICK_S = 0.005
# [s] of rest after which nothing lags any more; a film may go on for much longer
MAX_LAG_S = 0.5
# an effect and its parameters, (C, 1, 1) each
HandEffectValues = tuple[type[HandEffect], Mapping[str, np.ndarray]]


@dataclass(frozen=True)
class HandMotion:
    """Poses of the grasp on a uniform tick, cubic Hermite between.

    start: time of the first pose [s]. tick: period [s]. pose: (B, K, 3) x [m], y [m],
    theta [rad], theta continuous. rate: (B, K, 3) its time derivative. B is the number
    of motions: 1 (shared by all candidates) or one for each candidate.
    """

    start: float
    tick: float
    pose: np.ndarray
    rate: np.ndarray

    @property
    def end(self) -> float:
        """Time of the last pose [s]."""
        return self.start + (self.pose.shape[1] - 1) * self.tick

    def extended_until(self, until: float) -> HandMotion:
        """The motion with rest after its last pose, until a time [s] or as long as
        anything lags behind it.
        """
        return HandMotion(
            self.start,
            self.tick,
            *_append_rest_seconds(self.pose, self.rate, until - self.end, self.tick),
        )

    def starting_at(self, begin: float | np.ndarray) -> HandMotion:
        """The motion from a moment on [s], or from one for each candidate, (C,): then
        time counts from it.

        Before its first pose and after its last the hand rests.
        """
        count = max(int(np.ceil((self.end - np.min(begin)) / self.tick - 1e-9)), 1) + 1
        ticks = (np.reshape(begin, (-1, 1)) - self.start) / self.tick + np.arange(count)
        known = np.arange(self.pose.shape[1])
        place = np.clip(ticks, 0, known[-1])
        before = np.minimum(place.astype(int), known[-1] - 1)
        row = np.arange(len(self.pose))[:, None]
        cubic = interpolate.CubicHermiteSpline(
            known, self.pose, self.rate * self.tick, axis=1
        )
        pose, rate = (
            np.polyval(part.c[:, before, row], (place - before)[..., None])
            for part in (cubic, cubic.derivative())
        )
        rate = np.where((ticks == place)[..., None], rate / self.tick, 0.0)
        return HandMotion(
            float(begin) if np.ndim(begin) == 0 else 0.0, self.tick, pose, rate
        )

    def actual_hand_motion(
        self, arm: Arm, acts: Sequence[HandEffectValues]
    ) -> HandMotion:
        """The hand's actual motion with effects on the grasp, each with its values, one
        for all candidates or one each. Raises DataError if one needs joint angles.
        """
        motion = self
        for effect, parameters in acts:
            if "grasp" not in effect.laws():
                raise DataError(
                    f"effect '{effect.name}' acts on joint angles, but this trial has only poses of the grasp. "
                    "Add arm.parquet, or leave the effect out."
                )
            pose, rate = _apply_law(
                effect, "grasp", motion, motion.pose, motion.rate, parameters
            )
            motion = HandMotion(self.start, self.tick, pose, rate)
        return motion


@dataclass(frozen=True)
class JointMotion:
    """Joint angles on a uniform tick. angles: (B, K, J) [rad]; speeds: (B, K, J)
    [rad/s]; otherwise as HandMotion.
    """

    start: float
    tick: float
    angles: np.ndarray
    speeds: np.ndarray

    def extended_until(self, until: float) -> JointMotion:
        """The motion with rest after its last sample, until a time [s] or as long as
        anything lags behind it.
        """
        end = self.start + (self.angles.shape[1] - 1) * self.tick
        return JointMotion(
            self.start,
            self.tick,
            *_append_rest_seconds(self.angles, self.speeds, until - end, self.tick),
        )

    def hand_motion(self, arm: Arm) -> HandMotion:
        """The hand's motion by an arm's forward kinematics."""
        return HandMotion(
            self.start,
            self.tick,
            arm.grasp_pose(self.angles),
            arm.grasp_velocity(self.angles, self.speeds),
        )

    def actual_joint_motion(self, acts: Sequence[HandEffectValues]) -> JointMotion:
        """The joints' actual motion with effects on them, each with its values, one for
        all candidates or one each.
        """
        motion = self
        for effect, parameters in acts:
            if "joints" in effect.laws():
                angles, speeds = _apply_law(
                    effect, "joints", motion, motion.angles, motion.speeds, parameters
                )
                motion = JointMotion(self.start, self.tick, angles, speeds)
        return motion

    def actual_hand_motion(
        self, arm: Arm, acts: Sequence[HandEffectValues]
    ) -> HandMotion:
        """The hand's actual motion with effects on the joints, then those on the grasp."""
        later = [act for act in acts if "joints" not in act[0].laws()]
        return (
            self.actual_joint_motion(acts)
            .hand_motion(arm)
            .actual_hand_motion(arm, later)
        )


def resample_joint_motion(
    t: np.ndarray, angles: np.ndarray, tick: float = HAND_TICK_S
) -> JointMotion:
    """Joint angles on a uniform tick.

    t: (K,) increasing times [s]. angles: (K, J) or (B, K, J) joint angles [rad]. The
    joints are taken as natural cubic splines between samples; tick: period of the
    result [s].
    """
    grid = _tick_times(t, tick)
    batch = angles if angles.ndim == 3 else angles[None]
    spline = interpolate.CubicSpline(t, batch, axis=1, bc_type="natural")
    return JointMotion(float(grid[0]), tick, spline(grid), spline(grid, 1))


def resample_hand_motion(
    t: np.ndarray, pose: np.ndarray, tick: float = HAND_TICK_S
) -> HandMotion:
    """The hand's motion from grasp poses. t: (K,) increasing [s]; pose: (K, 3) or (B,
    K, 3), theta unwrapped here.
    """
    batch = np.array(pose if pose.ndim == 3 else pose[None], dtype=float)
    batch[..., 2] = np.unwrap(batch[..., 2], axis=1)
    grid = _tick_times(t, tick)
    spline = interpolate.CubicSpline(t, batch, axis=1, bc_type="natural")
    return HandMotion(float(grid[0]), tick, spline(grid), spline(grid, 1))


def _append_rest_seconds(
    value: np.ndarray, rate: np.ndarray, seconds: float, tick: float
) -> tuple[np.ndarray, np.ndarray]:
    """Value and rate, (B, K, ...) each, with rest for further seconds, if any."""
    return append_rest_ticks(
        value, rate, int(np.ceil(np.clip(seconds, 0.0, MAX_LAG_S) / tick - 1e-9))
    )


def append_rest_ticks(
    value: np.ndarray, rate: np.ndarray, more: int
) -> tuple[np.ndarray, np.ndarray]:
    """Value and rate, (B, K, ...) each, with rest on so many further ticks."""
    still = np.zeros_like(rate[:, -1:]).repeat(more, axis=1)
    return np.concatenate(
        [value, value[:, -1:].repeat(more, axis=1)], axis=1
    ), np.concatenate([rate, still], axis=1)


def _apply_law(
    effect: type[HandEffect],
    law: str,
    motion: HandMotion | JointMotion,
    value: np.ndarray,
    rate: np.ndarray,
    parameters: Mapping[str, np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """Value and rate, (B, K, ...) each, after a law, which is asked only of candidates
    in which it is not absent.

    Only the change is differentiated, so that none costs nothing.
    """
    acts = np.any(
        [parameters[p.name].ravel() != p.start for p in effect.parameters], axis=0
    )
    if not acts.any():
        return value, rate
    t = motion.start + motion.tick * np.arange(value.shape[1])
    own = value if len(value) == 1 else value[acts]
    change = (
        effect.laws()[law](
            t, own, **{name: given[acts] for name, given in parameters.items()}
        )
        - own
    )
    value, rate = (
        np.broadcast_to(each, (len(acts), *each.shape[1:])).copy()
        for each in (value, rate)
    )
    value[acts] += change
    rate[acts] += interpolate.CubicSpline(t, change, axis=1, bc_type="natural")(t, 1)
    return value, rate


def _tick_times(t: np.ndarray, tick: float) -> np.ndarray:
    """Ticks from the first sample to the last that fits, at least two."""
    count = max(int(np.floor((t[-1] - t[0]) / tick + 1e-9)) + 1, 2)
    return t[0] + tick * np.arange(count)
