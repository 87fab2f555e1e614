"""The forward model as one: hand, string, clocks and camera, with the effects at work
in each.

    joint angles -> HAND -> grasp -> STRING -> mass points -> CAMERA -> what is reported

Everything that generates, estimates or diagnoses asks this model. What is absent is not
there, and costs nothing.
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
from stringcast.stages.model.parameter import Parameter, Parametrised
from stringcast.stages.model.state import StringState
from stringcast.stages.model.string import String

interpolate = LazyModule("scipy.interpolate")

EffectT = TypeVar("EffectT", bound=Effect)
VELOCITY_STEP_S = 1e-4  # [s] over which velocities are differenced for the camera


@dataclass(frozen=True)
class Model(Parametrised):
    """A string in a hand before a camera. Effects on the string are the string's own;
    the others act in turn.

    known: values of parameters by qualified name, at which a search starts instead of
    at their own start. measured: ranges [low, high] to which a measurement beforehand
    narrows parameters, by qualified name.
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
        """All effects at work, the paper's forces first."""
        return (*self.string.effects, *self._outer_effects)

    @property
    def _outer_effects(self) -> tuple[type[Effect], ...]:
        return (*self.hand_effects, *self.clock_effects, *self.camera_effects)

    def with_effects(self, *effects: type[Effect]) -> Model:
        """The model with these effects too, each in its world. Raises ValueError for
        one that is at work already.
        """
        model = self
        for effect in effects:
            if effect in model.effects:
                raise ValueError(
                    f"effect '{effect.name}' is at work already. Name it once."
                )
            if issubclass(effect, ModelChange):
                model = model.with_segments(effect.points(model.string.points) - 1)
            elif issubclass(effect, StringEffect):
                model = replace(
                    model,
                    string=replace(
                        model.string, effects=(*model.string.effects, effect)
                    ),
                )
            elif issubclass(effect, HandEffect):
                model = replace(
                    model, hand_effects=_sort_by_order(*model.hand_effects, effect)
                )
            elif issubclass(effect, ClockEffect):
                model = replace(
                    model, clock_effects=_sort_by_order(*model.clock_effects, effect)
                )
            else:
                assert issubclass(effect, CameraEffect)
                model = replace(
                    model, camera_effects=_sort_by_order(*model.camera_effects, effect)
                )
        return model

    def with_segments(self, segments: int) -> Model:
        """The model with its string in so many segments."""
        if segments not in self._meshes:
            self._meshes[segments] = replace(
                self, string=replace(self.string, points=segments + 1)
            )
        return self._meshes[segments]

    @cached_property
    def _meshes(self) -> dict[int, Model]:
        """Cache of `divided`."""
        return {}

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """All parameters, with qualified names: the string's first."""
        others = (
            replace(p, name=e.qualified_name(p))
            for e in self._outer_effects
            for p in e.parameters
        )
        every = (*self.string.parameters, *others)
        ends = (self.measured_ranges.get(p.name, (p.low, p.high)) for p in every)
        known = zip(every, ends, strict=True)
        return tuple(
            replace(p, low=low, high=high, start=self.start_values.get(p.name, p.start))
            for p, (low, high) in known
        )

    def hand_motion(
        self, motion: JointMotion | HandMotion, values: np.ndarray
    ) -> HandMotion:
        """The hand's actual motion, one for all candidates or one each. values: (C, P)."""
        return motion.actual_hand_motion(self.arm, self._hand_effect_values(values))

    def joint_motion(self, motion: JointMotion, values: np.ndarray) -> JointMotion:
        """The joints' actual motion. values: (C, P)."""
        return motion.actual_joint_motion(self._hand_effect_values(values))

    def simulate_string(
        self,
        motion: JointMotion | HandMotion,
        values: np.ndarray,
        times: np.ndarray,
        initial: StringState | None = None,
        turn: float = 0.0,
    ) -> StringMotion:
        """Positions of the strings of candidates. values: (C, P); times: (F,) or (C, F)
        of the arm's clock [s].

        initial: the state from which they move, of the same clock; else they rest
        before the hand moves. turn: on which side of the hand they do, as of
        `equilibrium.hanging`.
        """
        hand = self.hand_motion(motion, values)
        if initial is not None:
            hand, times = hand.starting_at(initial.t), initial.times_since_start(times)
        return simulate(
            self.string,
            hand,
            values[:, : len(self.string.parameters)],
            times,
            initial,
            turn,
        )

    def simulate_observation(
        self,
        motion: JointMotion | HandMotion,
        values: np.ndarray,
        times: np.ndarray,
        initial: StringState | None = None,
        turn: float = 0.0,
    ) -> StringMotion:
        """The strings of candidates as the camera reports them. values: (C, P); times:
        (F,) of the camera's clock [s].

        initial, turn: as of `true`, a state by the camera's clock.
        """
        initial = self.initial_state_on_arm_clock(initial, values)
        real = self.simulate_string(
            motion, values, self.required_times(values, times), initial, turn
        )
        return StringMotion(
            self.observed_points(real.points, values, times), real.finite
        )

    def initial_state_on_arm_clock(
        self, initial: StringState | None, values: np.ndarray
    ) -> StringState | None:
        """A state of the camera's clock by the arm's. values: (C, P)."""
        return (
            None
            if initial is None
            else initial.with_time(
                self._arm_times(values, np.array([initial.t]))[..., 0]
            )
        )

    def required_times(self, values: np.ndarray, times: np.ndarray) -> np.ndarray:
        """Times of the arm's clock at which `reported` needs points, (M,) or (C, M)
        [s]. times: (F,).
        """
        times = self._arm_times(values, times)
        if not self.camera_effects:
            return times
        # Nothing later than the last frame: its string should not depend on whether
        # velocities are wanted.
        after = np.minimum(times + VELOCITY_STEP_S, times.max(axis=-1, keepdims=True))
        return np.concatenate([times - VELOCITY_STEP_S, times, after], axis=-1)

    def _arm_times(self, values: np.ndarray, times: np.ndarray) -> np.ndarray:
        """Times of the arm's clock [s] at times of the camera's (F,), (F,) or (C, F)."""
        for effect in self.clock_effects:
            times = effect.times(times, **self._effect_values(effect, values, 2))
        return times

    def observed_points(
        self, points: np.ndarray, values: np.ndarray, times: np.ndarray
    ) -> np.ndarray:
        """Points that the camera reports, (C, F, n, 2) [m]. points: true ones at
        `moments`, (C, M, n, 2). times: (F,) [s].
        """
        if not self.camera_effects:
            return points
        before, now, after = np.split(points, 3, axis=1)
        first, _, last = np.split(
            np.atleast_2d(self.required_times(values, times)), 3, axis=1
        )
        velocity = (after - before) / (last - first)[..., None, None]
        for effect in self.camera_effects:
            now = effect.observe(
                now,
                velocity,
                times,
                self.camera,
                **self._effect_values(effect, values, 4),
            )
        return now

    def observed_arm(
        self, motion: JointMotion, values: np.ndarray, times: np.ndarray
    ) -> np.ndarray:
        """The arm's joints as the camera reports them, base to hand, (1 or C, F, J + 1,
        2) [m]; at rest beyond its motion. It is rigid, so no string is simulated.
        times: (F,) of the camera's clock [s].
        """
        moments, real = (
            np.atleast_2d(self.required_times(values, times)),
            self.joint_motion(motion, values),
        )
        ticks = real.start + real.tick * np.arange(real.angles.shape[1])
        inside = np.clip(moments, ticks[0], ticks[-1])
        if len(real.angles) == 1:
            angles = interpolate.CubicHermiteSpline(
                ticks, real.angles[0], real.speeds[0]
            )(inside)
        else:
            asked = np.broadcast_to(inside, (len(real.angles), inside.shape[1]))
            each = zip(real.angles, real.speeds, asked, strict=True)
            angles = np.stack(
                [interpolate.CubicHermiteSpline(ticks, q, w)(own) for q, w, own in each]
            )
        return self.observed_points(self.arm.joint_positions(angles), values, times)

    def _hand_effect_values(self, values: np.ndarray) -> Sequence[HandEffectValues]:
        return [
            (effect, self._effect_values(effect, values, 3))
            for effect in self.hand_effects
        ]

    def _effect_values(
        self, effect: type[Effect], values: np.ndarray, dimensions: int
    ) -> dict[str, np.ndarray]:
        """An effect's parameters by their own names, the candidates along the first of
        so many dimensions.
        """
        places = {
            p.name: self.names.index(effect.qualified_name(p))
            for p in effect.parameters
        }
        return {
            n: values[:, place].reshape(-1, *[1] * (dimensions - 1))
            for n, place in places.items()
        }


def _sort_by_order(*effects: type[EffectT]) -> tuple[type[EffectT], ...]:
    """Effects that do not commute, as they act in the world: naming them in another
    order changes nothing.
    """
    return tuple(sorted(effects, key=lambda effect: (effect.order, effect.name)))
