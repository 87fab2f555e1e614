"""The forward model: hand, string, clocks and camera, with the effects on each.

    joint angles -> HAND -> grasp -> STRING -> mass points -> CAMERA -> reported points

Casting, estimation and diagnosis use this model. Absent effects take no time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from stringcast.data.lazy_module import LazyModule
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.camera import Camera
from stringcast.stages.model.effect import (
    CameraEffect,
    ClockEffect,
    Effect,
    HandEffect,
    ModelChange,
    StringEffect,
)
from stringcast.stages.model.engine.simulate import StringMotion, simulate
from stringcast.stages.model.hand import HandEffectValues, HandMotion, JointMotion
from stringcast.stages.model.parameter import Parameter
from stringcast.stages.model.parametrised import Parametrised
from stringcast.stages.model.state import StringState
from stringcast.stages.model.string import String

interpolate = LazyModule("scipy.interpolate")

EffectT = TypeVar("EffectT", bound=Effect)
VELOCITY_STEP_S = 1e-4  # of the central difference for the camera


@dataclass(frozen=True)
class Model(Parametrised):
    """A string, the hand that holds it, and the camera that observes it.

    Parameters
    ----------
    string : String
        The string, with the effects on it.
    arm : Arm
        Geometry of the arm.
    camera : Camera
        Nominal camera.
    hand_effects, clock_effects, camera_effects : tuple of Effect classes
        Effects on hand, clocks and camera, in the order in which they act.
    start_values : mapping of str to float
        Initial values that replace a parameter's own start in a search, by qualified
        name.
    measured_ranges : mapping of str to (float, float)
        Narrower ranges of parameters from an earlier measurement, by qualified name.
    """

    string: String
    arm: Arm
    camera: Camera
    hand_effects: tuple[type[HandEffect], ...] = ()
    clock_effects: tuple[type[ClockEffect], ...] = ()
    camera_effects: tuple[type[CameraEffect], ...] = ()
    start_values: Mapping[str, float] = field(default_factory=dict)
    measured_ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def effects(self) -> tuple[type[Effect], ...]:
        """All active effects, the paper's forces first."""
        return (*self.string.effects, *self._outer_effects)

    @property
    def _outer_effects(self) -> tuple[type[Effect], ...]:
        return (*self.hand_effects, *self.clock_effects, *self.camera_effects)

    def with_effects(self, *effects: type[Effect]) -> Model:
        """Add effects to hand, string, clocks and camera.

        Raises ValueError if an effect is active already.
        """
        model = self
        for effect in effects:
            if effect in model.effects:
                raise ValueError(
                    f"effect '{effect.name}' is active already. Name it once."
                )
            model = model._with_effect(effect)
        return model

    def _with_effect(self, effect: type[Effect]) -> Model:
        if issubclass(effect, ModelChange):
            return self.with_segments(effect.points(self.string.points) - 1)
        if issubclass(effect, StringEffect):
            string = replace(self.string, effects=(*self.string.effects, effect))
            return replace(self, string=string)
        if issubclass(effect, HandEffect):
            return replace(
                self, hand_effects=_sort_by_order(*self.hand_effects, effect)
            )
        if issubclass(effect, ClockEffect):
            return replace(
                self, clock_effects=_sort_by_order(*self.clock_effects, effect)
            )
        assert issubclass(effect, CameraEffect)
        return replace(
            self, camera_effects=_sort_by_order(*self.camera_effects, effect)
        )

    def with_ranges(self, *parameters: Parameter) -> Model:
        """Return the model with other ranges of its string's parameters."""
        others = {parameter.name: parameter for parameter in parameters}
        string = replace(self.string, ranges={**self.string.ranges, **others})
        return replace(self, string=string)

    def with_segments(self, segments: int) -> Model:
        """Return the model with `segments` segments of its string, from a cache."""
        if segments not in self._meshes:
            string = replace(self.string, points=segments + 1)
            self._meshes[segments] = replace(self, string=string)
        return self._meshes[segments]

    @cached_property
    def _meshes(self) -> dict[int, Model]:
        """Cache of models with other numbers of segments."""
        return {}

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """All parameters, with qualified names: the string's first."""
        parameters = list(self.string.parameters)
        for effect in self._outer_effects:
            parameters += effect.qualified_parameters()
        return tuple(self._with_known_values(p) for p in parameters)

    def _with_known_values(self, parameter: Parameter) -> Parameter:
        name = parameter.name
        low, high = self.measured_ranges.get(name, (parameter.low, parameter.high))
        start = self.start_values.get(name, parameter.start)
        return replace(parameter, low=low, high=high, start=start)

    # --- the hand -----------------------------------------------------------

    def hand_motion(
        self, motion: JointMotion | HandMotion, values: np.ndarray
    ) -> HandMotion:
        """Return the hand's actual motion, one for all candidates or one each.

        values: (C, P).
        """
        return motion.actual_hand_motion(self.arm, self._hand_effect_values(values))

    def joint_motion(self, motion: JointMotion, values: np.ndarray) -> JointMotion:
        """Return the joints' actual motion. values: (C, P)."""
        return motion.actual_joint_motion(self._hand_effect_values(values))

    # --- the string ---------------------------------------------------------

    def simulate_string(
        self,
        motion: JointMotion | HandMotion,
        values: np.ndarray,
        times: np.ndarray,
        initial: StringState | None = None,
        turn: float = 0.0,
    ) -> StringMotion:
        """Simulate the strings of candidates.

        Parameters
        ----------
        motion : JointMotion or HandMotion
            Motion that the arm reports.
        values : ndarray of shape (C, P)
            Parameters of the candidates, in the order of `parameters`.
        times : ndarray of shape (F,) or (C, F)
            Times of the arm's clock [s].
        initial : StringState, optional
            Initial state, on the arm's clock. Without it the string hangs at rest.
        turn : float
            Side of the hand at rest, as in `equilibrium.hanging_shape` [rad].

        Returns
        -------
        StringMotion
            Actual positions.
        """
        hand = self.hand_motion(motion, values)
        if initial is not None:
            hand = hand.starting_at(initial.t)
            times = initial.times_since_start(times)
        string_values = values[:, : len(self.string.parameters)]
        return simulate(self.string, hand, string_values, times, initial, turn)

    def simulate_observation(
        self,
        motion: JointMotion | HandMotion,
        values: np.ndarray,
        times: np.ndarray,
        initial: StringState | None = None,
        turn: float = 0.0,
    ) -> StringMotion:
        """Simulate the strings of candidates as the camera reports them.

        Parameters
        ----------
        motion : JointMotion or HandMotion
            Motion that the arm reports.
        values : ndarray of shape (C, P)
            Parameters of the candidates, in the order of `parameters`.
        times : ndarray of shape (F,)
            Times of the camera's clock [s].
        initial : StringState, optional
            As in `simulate_string`, but on the camera's clock.
        turn : float
            As in `simulate_string`.

        Returns
        -------
        StringMotion
            Reported positions.
        """
        initial = self.initial_state_on_arm_clock(initial, values)
        arm_times = self.required_times(values, times)
        actual = self.simulate_string(motion, values, arm_times, initial, turn)
        points = self.observed_points(actual.points, values, times)
        return StringMotion(points, actual.finite)

    # --- clocks and camera --------------------------------------------------

    def initial_state_on_arm_clock(
        self, initial: StringState | None, values: np.ndarray
    ) -> StringState | None:
        """Convert a state from the camera's clock to the arm's. values: (C, P)."""
        if initial is None:
            return None
        arm_time = self._arm_times(values, np.array([initial.t]))[..., 0]
        return replace(initial, t=arm_time)

    def required_times(self, values: np.ndarray, times: np.ndarray) -> np.ndarray:
        """Return times of the arm's clock at which `observed_points` needs points.

        They are (M,) or (C, M) [s]. times: (F,) on the camera's clock.
        """
        times = self._arm_times(values, times)
        if not self.camera_uses_velocity:
            return times
        # Times end with the last frame, so that velocities do not change the string.
        last = times.max(axis=-1, keepdims=True)
        after = np.minimum(times + VELOCITY_STEP_S, last)
        return np.concatenate([times - VELOCITY_STEP_S, times, after], axis=-1)

    @property
    def camera_uses_velocity(self) -> bool:
        """Whether reported points depend on velocities."""
        return any(effect.uses_velocity for effect in self.camera_effects)

    def _arm_times(self, values: np.ndarray, times: np.ndarray) -> np.ndarray:
        """Return the arm's times, (F,) or (C, F), at the camera's times (F,) [s]."""
        for effect in self.clock_effects:
            times = effect.times(times, **self._effect_values(effect, values, 2))
        return times

    def observed_points(
        self, points: np.ndarray, values: np.ndarray, times: np.ndarray
    ) -> np.ndarray:
        """Return the points that the camera reports.

        Parameters
        ----------
        points : ndarray of shape (C, M, n, 2)
            Actual positions at `required_times` [m].
        values : ndarray of shape (C, P)
            Parameters of the candidates.
        times : ndarray of shape (F,)
            Times of the camera's clock [s].

        Returns
        -------
        ndarray of shape (C, F, n, 2)
            Reported positions [m].
        """
        now = points
        velocity = np.zeros((1, 1, 1, 2))
        if self.camera_uses_velocity:
            before, now, after = np.split(points, 3, axis=1)
            arm_times = np.atleast_2d(self.required_times(values, times))
            first, _, last = np.split(arm_times, 3, axis=1)
            velocity = (after - before) / (last - first)[..., None, None]
        for effect in self.camera_effects:
            parameters = self._effect_values(effect, values, 4)
            now = effect.observe(now, velocity, times, self.camera, **parameters)
        return now

    def observed_arm(
        self, motion: JointMotion, values: np.ndarray, times: np.ndarray
    ) -> np.ndarray:
        """Return the reported positions of the arm's joints, from base to hand.

        They are (1 or C, F, J + 1, 2) [m]. The arm rests before and after its motion.
        No string is simulated. times: (F,) on the camera's clock [s].
        """
        arm_times = np.atleast_2d(self.required_times(values, times))
        actual = self.joint_motion(motion, values)
        ticks = actual.times
        inside = np.clip(arm_times, ticks[0], ticks[-1])
        motions = len(actual.angles)
        if motions > 1:
            inside = np.broadcast_to(inside, (motions, inside.shape[1]))
        angles = []
        rows = np.split(inside, motions)
        for row, angle, speed in zip(rows, actual.angles, actual.speeds, strict=True):
            spline = interpolate.CubicHermiteSpline(ticks, angle, speed)
            angles.append(spline(row))
        joints = self.arm.joint_positions(np.concatenate(angles))
        return self.observed_points(joints, values, times)

    def _hand_effect_values(self, values: np.ndarray) -> Sequence[HandEffectValues]:
        effects = self.hand_effects
        return [(effect, self._effect_values(effect, values, 3)) for effect in effects]

    def _effect_values(
        self, effect: type[Effect], values: np.ndarray, dimensions: int
    ) -> dict[str, np.ndarray]:
        """Return an effect's parameters by their own names.

        Each has `dimensions` dimensions, the first over candidates.
        """
        shape = (-1, *[1] * (dimensions - 1))
        named = self.values_of(effect, values)
        return {name: value.reshape(shape) for name, value in named.items()}


def _sort_by_order(*effects: type[EffectT]) -> tuple[type[EffectT], ...]:
    """Sort effects that do not commute by their physical order."""
    return tuple(sorted(effects, key=lambda effect: (effect.order, effect.name)))
