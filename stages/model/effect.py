"""Base classes of effects: each physical cause is one class in one file.

The files lie in `stages/model/effects/` or in the folder `effects` of a plugin. File
and effect have the same name. The class holds the parameters with units and ranges, the
law, a description and a picture for a report, the reference, and invariants that tests
check. An effect whose parameters are at their start is absent. `effects/README.md`
shows how to write one.

The base class depends on where the cause acts: on the string (`StringEffect`), the hand
(`HandEffect`), the camera (`CameraEffect`), the clocks (`ClockEffect`) or the mesh of
the model (`ModelChange`).

The laws of the string run in the hot loop. They are static methods named after the
slots of `engine/law_slots.py`. A law takes by name any argument of its slot and any
parameter: its own, a derived one, or one of the paper's. It is written for one
candidate and one place, in arithmetic and NumPy functions without branches, and returns
the term it adds. Terms are per mass per length, so a law does not depend on the mesh.

A law with memory has two methods. `hinge_memory` updates the memory of a hinge whose
curvature changes by `change` within `dt`; `hinge_memory_moment` returns its moment.
`grasp_memory` and `grasp_memory_moment` do so for the grasp and its angle. The memory
of a string that hangs at rest is zero, because decaying swings leave none. A string
released elsewhere was pulled there slowly: its memory is `hinge_memory(memory=0,
change=curvature - curvature_at_rest, dt=inf)`.
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

# Everything that an effect's file imports, except NumPy.
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
    """Base class of all effects. The class is the effect; it has no instances.

    Attributes
    ----------
    name : str
        Name of the effect, and of its file.
    parameters : tuple of Parameter
        With units and ranges. At their start the effect is absent.
    reference : str
        Source of the law.
    invariants : tuple of Invariant
        Properties of the laws, which tests check on samples.
    law_names : tuple of str
        Names that a law may have.
    exclusion_reason : str
        Why a diagnosis does not look for it; empty if it does.
    varies_between_trials : bool
        Whether the effect depends on how the string was picked up or handled, and so
        may differ between trials.
    order : int
        Effects on hand, clocks or camera act in ascending order.
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
        """Draw a small picture of the law, in labelled axes."""

    @classmethod
    @cache
    def laws(cls) -> dict[str, Law]:
        """Return the laws that this effect defines, by name."""
        return {
            name: getattr(cls, name) for name in cls.law_names if hasattr(cls, name)
        }

    @classmethod
    def qualified_name(cls, parameter: Parameter) -> str:
        """Prefix a parameter's name with the effect's, unless the paper names it."""
        return parameter.name if parameter.symbol else f"{cls.name}.{parameter.name}"

    @classmethod
    def qualified_parameters(cls) -> list[Parameter]:
        """Return the parameters with qualified names."""
        return [replace(p, name=cls.qualified_name(p)) for p in cls.parameters]


class StringEffect(Effect):
    """An effect on the string, by laws that add terms. Subclasses are final.

    Its laws are named after slots. The step is bounded by sampling their slopes. A load
    that rises steeply with place, or with speed near rest, needs a static method
    `bound(**parameters)`: its largest contributions to the squared frequency [1/s^2]
    and the damping rate [1/s] of a mass, (C,) each.
    """

    law_names = tuple(SLOTS)

    @classmethod
    def plot(cls, axes: Axes, values: Values) -> None:
        """Draw the first law over an argument of its slot, or a hysteresis loop."""
        derived = cls.derive_parameters(**values)
        by_unit = {p.unit: values[p.name] for p in cls.parameters}
        of_a_point = any(p.length_power for p in cls.parameters)
        known = {**values, **derived}
        effect_plots.draw_law(axes, cls.laws(), known, by_unit, of_a_point)

    @staticmethod
    def derive_parameters(*_: Quantity, **parameters: Quantity) -> dict[str, Quantity]:
        """Derive quantities that laws need from the parameters.

        They are computed once for each candidate, outside the loop.
        """
        return {}


class HandEffect(Effect):
    """An effect between the reported and the actual motion of the hand.

    The law joints(t, angles, **parameters) returns the actual joint angles; grasp(t,
    pose, **parameters) returns the actual pose of the grasp. One is enough. The arm's
    report decides which applies: joint angles or poses. t: (K,) [s]. angles: (1 or C,
    K, J) [rad]. pose: (1 or C, K, 3) [m], [m], [rad]. Parameters are (C, 1, 1).
    Subclasses are final.
    """

    law_names = ("joints", "grasp")

    @classmethod
    def plot(cls, axes: Axes, values: Values) -> None:
        """Draw the actual swing of a joint, with the reported one dashed."""
        effect_plots.draw_joint_swing(axes, cls.laws()["joints"], list(values.values()))


class ClockEffect(Effect):
    """An effect between the camera's clock and the arm's. Subclasses are final."""

    law_names = ("times",)

    @staticmethod
    @abstractmethod
    def times(t: np.ndarray, *_: Quantity, **parameters: Quantity) -> np.ndarray:
        """Convert times of the camera's clock to the arm's clock.

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
        """Draw the difference of the clocks over time."""
        t = np.linspace(0.0, 1.0, 2)
        difference = cls.times(t, **values) - t
        labels = "camera's clock / s", "arm's clock less that / s"
        draw_line(axes, t, difference, *labels)


class CameraEffect(Effect):
    """An effect between actual and reported positions of points.

    Subclasses are final.

    Attributes
    ----------
    corrected_by_calibration : bool
        Whether a calibrated lens removes the effect, so that a diagnosis does not look
        for it.
    uses_velocity : bool
        Whether `observe` depends on the velocity. If not, a third of the simulated
        times is enough.
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
            Actual positions [m] and velocities [m/s] at the frame times.
        times : ndarray of shape (F,)
            Frame times [s].
        camera : Camera
            Nominal camera.
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
    """An error of the model itself: too few mass points."""

    @staticmethod
    @abstractmethod
    def points(points: int) -> int:
        """Return the number of mass points that replaces `points`."""


EffectT = TypeVar("EffectT", bound=Effect)


@cache
def numbered_effect(effect: type[EffectT], number: int) -> type[EffectT]:
    """Return a copy of the effect with a numbered name, to use several."""
    class_name = f"{effect.__name__}{number}"
    members = {"name": f"{effect.name}_{number}"}
    return cast("type[EffectT]", type(class_name, (effect,), members))


def amplitude_parameters(effect: type[Effect]) -> tuple[Parameter, ...]:
    """Return the parameters that set an effect's size.

    They are the first parameter and, as components of a vector, others in its unit.
    """
    return tuple(p for p in effect.parameters if p.unit == effect.parameters[0].unit)


def moment_percent_of_weight(moment: float) -> float:
    """Express a moment in per cent of the one that holds 100 mm of string level.

    moment: moment over mass per length [m3/s2].
    """
    return 100 * moment / (GRAVITY_M_S2 * 0.1**2 / 2)


@cache
def is_position_dependent(effect: type[Effect]) -> bool:
    """Return whether one of an effect's laws depends on the place of the string."""
    place = {"x", "y"} - {parameter.name for parameter in effect.parameters}
    return any(place & set(law_arguments(law)) for law in effect.laws().values())


@cache
def acts_abruptly(effect: type[Effect]) -> bool:
    """Return whether an effect has kinks, where the error of a step is of first order.

    Contacts have kinks at impact, and memory where the motion reverses.
    """
    return has_memory(effect.laws()) or is_position_dependent(effect)
