"""Effects: one physical cause is one class in one file.

With its law, parameters, description, reference and picture. A file of
`stages/model/effects/` (or of the folder `effects` of a plugin) holds one class and is
called like it. From it come the name, the parameters with units and bounds, the law,
its description and picture for a report, its reference, and the invariants that tests
hold it to. An effect whose parameters are at their start is absent. `effects/README.md`
shows how to write one.

There is a base class for each place where something can be other than the paper says:
on the string (`StringEffect`), in the hand (`HandEffect`), in the camera
(`CameraEffect`), between their clocks (`ClockEffect`), or in the model's own making
(`ModelChange`).

The laws of the string run in the hot loop. They are static methods named after the
slots of `engine/law_slots.py`, take by name any of their slot's arguments and any
parameter (their own, what they derive from them, or one of the paper's), and are
written for one candidate and one place, in arithmetic and NumPy functions without
branches. They return what they add. Everything is per mass per length, so that a law
knows nothing of mass points.

A law with memory is two: `hinge_memory` returns the memory of a hinge after its
curvature has changed by `change` within `dt`, from the memory before, and
`hinge_memory_moment` its moment; `grasp_memory` and `grasp_memory_moment` do so for the
grasp and its angle. The memory of a string that hangs at rest is empty, for the swings
that die down there leave it on neither side; one that is released elsewhere was pulled
there slowly, and remembers `hinge_memory(memory=0, change=curvature -
curvature_at_rest, dt=inf)`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar, cast

import numpy as np

from stringcast.stages.common import GRAVITY_M_S2
from stringcast.stages.model import effect_plots
from stringcast.stages.model.camera import Camera
from stringcast.stages.model.effect_plots import draw_line
from stringcast.stages.model.engine.law_slots import (
    SLOTS,
    Law,
    Quantity,
    has_memory,
    law_arguments,
)
from stringcast.stages.model.invariants import (
    Invariant,
    brakes,
    is_even,
    is_odd,
    moves_with_pose,
    reduces_to,
    resists,
    rotates_about_centre,
    rotates_with,
    shifts_with,
    vanishes_at_zero,
)
from stringcast.stages.model.parameter import Parameter

if TYPE_CHECKING:
    from matplotlib.axes import Axes
else:
    Axes = Any  # loading it takes a second

Values = Mapping[str, float]  # of parameters, by name

# All that an effect's file imports, beside NumPy.
__all__ = [
    "Axes",
    "Camera",
    "CameraEffect",
    "ClockEffect",
    "Effect",
    "HandEffect",
    "ModelChange",
    "Parameter",
    "Quantity",
    "StringEffect",
    "Values",
    "amplitude_parameters",
    "brakes",
    "draw_line",
    "is_even",
    "is_odd",
    "is_position_dependent",
    "moment_percent_of_weight",
    "moves_with_pose",
    "numbered_effect",
    "reduces_to",
    "resists",
    "rotates_about_centre",
    "rotates_with",
    "shifts_with",
    "vanishes_at_zero",
]


class Effect(ABC):
    """Base of all effects, which are never instantiated: the class is the effect.

    Attributes
    ----------
    name : str
        Name of the effect, and of its file.
    parameters : tuple of Parameter
        With units and ranges. At their start the effect is absent.
    reference : str
        Where the law is from.
    invariants : tuple of Invariant
        Properties of the laws, which tests check on samples.
    law_names : tuple of str
        Names that a law may have.
    exclusion_reason : str
        Why a diagnosis does not look for it; empty if it does.
    varies_between_trials : bool
        It comes with how the string was picked up or handled before, and may differ
        from trial to trial.
    order : int
        Of effects on hand, clocks or camera, those of a lower order act first, whatever
        the order in which they are named.
    """

    name: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    reference: ClassVar[str]
    invariants: ClassVar[tuple[Invariant, ...]] = ()
    law_names: ClassVar[tuple[str, ...]] = ()
    exclusion_reason: ClassVar[str] = ""
    varies_between_trials: ClassVar[bool] = False
    order: ClassVar[int] = 0

    @staticmethod
    @abstractmethod
    def describe(values: Values) -> str:
        """Describe the effect with these parameters, without a full stop."""

    @classmethod
    @abstractmethod
    def plot(cls, axes: Axes, values: Values) -> None:
        """Draw a small picture of the law, in named axes."""

    @classmethod
    @cache
    def laws(cls) -> dict[str, Law]:
        """Return the laws that this effect defines, by name."""
        return {
            name: getattr(cls, name) for name in cls.law_names if hasattr(cls, name)
        }

    @classmethod
    def qualified_name(cls, parameter: Parameter) -> str:
        """Name a parameter among those of all effects: the paper's own stand alone."""
        return parameter.name if parameter.symbol else f"{cls.name}.{parameter.name}"

    @classmethod
    def qualified_parameters(cls) -> list[Parameter]:
        """Return the parameters with qualified names."""
        return [replace(p, name=cls.qualified_name(p)) for p in cls.parameters]


class StringEffect(Effect):
    """An effect on the string, by laws that only ever add. Subclasses are final.

    Its laws are named after slots. How stiff inner forces and air resistance are is
    found by sampling them. A load that rises steeply with place, or with speed near
    rest, declares it by a static method `bound(**parameters)`: what it adds at most to
    the squared frequency [1/s^2] and the damping rate [1/s] of a mass, each (C,).
    """

    law_names = tuple(SLOTS)

    @classmethod
    def plot(cls, axes: Axes, values: Values) -> None:
        """Draw the first law over an argument of its slot, or the loop of a memory."""
        derived = cls.derive_parameters(**values)
        by_unit = {p.unit: values[p.name] for p in cls.parameters}
        of_a_point = any(p.length_power for p in cls.parameters)
        known = {**values, **derived}
        effect_plots.draw_law(axes, cls.laws(), known, by_unit, of_a_point)

    @staticmethod
    def derive_parameters(*_: Quantity, **parameters: Quantity) -> dict[str, Quantity]:
        """Derive quantities of the parameters alone that laws need.

        Computed once for each candidate, and not in the loop.
        """
        return {}


class HandEffect(Effect):
    """An effect between what the arm reports and where the grasp really is.

    Laws are joints(t, angles, **parameters), which returns the joint angles that really
    happened, and/or grasp(t, pose, **parameters), which returns the pose of the grasp
    that really happened. With joint angles the first is used, with poses of the grasp
    the second. t: (K,) [s]. angles: (1 or C, K, J) [rad]. pose: (1 or C, K, 3) [m],
    [m], [rad]. Parameters are (C, 1, 1). Subclasses are final.
    """

    law_names = ("joints", "grasp")

    @classmethod
    def plot(cls, axes: Axes, values: Values) -> None:
        """Draw the actual swing of a joint, and the reported one dashed."""
        effect_plots.draw_joint_swing(axes, cls.laws()["joints"], list(values.values()))


class ClockEffect(Effect):
    """An effect between the camera's clock and the arm's. Subclasses are final."""

    law_names = ("times",)

    @staticmethod
    @abstractmethod
    def times(t: np.ndarray, *_: Quantity, **parameters: Quantity) -> np.ndarray:
        """Return times of the arm's clock at times of the camera's.

        Parameters
        ----------
        t : ndarray of shape (F,) or (C, F)
            Times of the camera's clock [s].
        **parameters : ndarray of shape (C, 1)
            Parameters of the effect.

        Returns
        -------
        ndarray of shape (C, F)
            Times of the arm's clock [s].
        """

    @classmethod
    def plot(cls, axes: Axes, values: Values) -> None:
        """Draw the difference over time."""
        t = np.linspace(0.0, 1.0, 2)
        gained = cls.times(t, **values) - t
        labels = "camera's clock / s", "arm's clock less that / s"
        draw_line(axes, t, gained, *labels)


class CameraEffect(Effect):
    """An effect between where points are and where the camera reports them.

    Subclasses are final.

    Attributes
    ----------
    corrected_by_calibration : bool
        A calibrated lens leaves nothing of it, so that a diagnosis does not look for
        it.
    uses_velocity : bool
        `observe` depends on the velocity. Otherwise that may be zero, which saves two
        thirds of the simulated moments.
    """

    law_names = ("observe",)
    corrected_by_calibration: ClassVar[bool] = False
    uses_velocity: ClassVar[bool] = True

    @staticmethod
    @abstractmethod
    def observe(
        points: np.ndarray,
        velocity: np.ndarray,
        times: np.ndarray,
        camera: Camera,
        *_: Quantity,
        **parameters: Quantity,
    ) -> np.ndarray:
        """Return the points that the camera reports.

        Parameters
        ----------
        points, velocity : ndarray of shape (C, F, n, 2)
            True ones at the frame times [m], [m/s].
        times : ndarray of shape (F,)
            Frame times [s].
        camera : Camera
            The camera as it is taken to be.
        **parameters : ndarray of shape (C, 1, 1, 1)
            Parameters of the effect.

        Returns
        -------
        ndarray of shape (C, F, n, 2)
            Reported points [m].
        """

    @classmethod
    def plot(cls, axes: Axes, values: Values) -> None:
        """Draw a square grid as the camera reports it."""
        effect_plots.draw_observed_grid(axes, cls.observe, **values)


class ModelChange(Effect):
    """Something wrong with the model's own making: another number of mass points."""

    @staticmethod
    @abstractmethod
    def points(points: int) -> int:
        """Return the number of mass points instead of so many."""


EffectT = TypeVar("EffectT", bound=Effect)


@cache
def numbered_effect(effect: type[EffectT], number: int) -> type[EffectT]:
    """Return the effect under a numbered name: several of a kind can be active."""
    class_name = f"{effect.__name__}{number}"
    members = {"name": f"{effect.name}_{number}"}
    return cast("type[EffectT]", type(class_name, (effect,), members))


def amplitude_parameters(effect: type[Effect]) -> tuple[Parameter, ...]:
    """Return the parameters that are an effect's size.

    Its first, and others in the same unit, which are other components of a vector.
    """
    return tuple(p for p in effect.parameters if p.unit == effect.parameters[0].unit)


def moment_percent_of_weight(moment: float) -> float:
    """Express a moment in per cent of the one that holds 100 mm of string out level.

    moment: over mass per length [m3/s2].
    """
    return 100 * moment / (GRAVITY_M_S2 * 0.1**2 / 2)


@cache
def is_position_dependent(effect: type[Effect]) -> bool:
    """Return whether one of an effect's laws depends on where the string is."""
    place = {"x", "y"} - {parameter.name for parameter in effect.parameters}
    return any(place & set(law_arguments(law)) for law in effect.laws().values())


@cache
def acts_abruptly(effect: type[Effect]) -> bool:
    """Return whether an effect sets in or turns at moments that steps must catch.

    So do contacts, and memory where the motion turns back: the error of a step is of
    first order there.
    """
    return has_memory(effect.laws()) or is_position_dependent(effect)
