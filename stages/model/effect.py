"""Effects: one physical cause is one class in one file, with its law, parameters,
description, reference and picture.

A file of `stages/model/effects/` (or of a folder named in STRINGCAST_EFFECTS) holds one
class and is called like it. From it come the name, the parameters with units and
bounds, the law, its description and picture for a report, its reference, and the
invariants that tests hold it to. An effect whose parameters are at their start is
absent.

There is a base class for each place where something can be other than the paper says:
on the string (`StringEffect`), in the hand (`HandEffect`), in the camera
(`CameraEffect`), between their clocks (`ClockEffect`), or in the model's own making
(`ModelChange`).

The laws of the string run in the hot loop. They are static methods named after the
slots of `slots.py`, take by name any of their slot's arguments and any parameter (their
own, what they derive from them, or one of the paper's), and are written for one
candidate and one place, in arithmetic and numpy functions without branches. They return
what they add. Everything is per mass per length, so that a law knows nothing of mass
points.

A law with memory is two: `held` says what a hinge holds after its curvature has changed
by `change` within `dt`, from what it held before, and `held_moment` the moment of that;
`grasp_held` and `grasp_held_moment` say it of the grasp and its angle. A string that
hangs at rest holds nothing, for the swings that die down there leave it on neither
side; one that is let go elsewhere was pulled there slowly, and holds `held(held=0,
change=curvature - curvature_at_rest, dt=inf)`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar, cast

import numpy as np

from stringcast.stages.model import effect_plots
from stringcast.stages.model.camera import Camera
from stringcast.stages.model.effect_plots import draw_line
from stringcast.stages.model.engine.law_slots import SLOTS, Law, Quantity, law_arguments
from stringcast.stages.model.invariants import (
    Invariant,
    brakes,
    even,
    moves_with_pose,
    never_negative,
    odd,
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

# All that an effect's file imports, beside numpy.
__all__ = [
    "Axes", "Camera", "CameraEffect", "ClockEffect", "Effect", "HandEffect", "ModelChange", "Parameter", "Quantity",
    "StringEffect", "Values", "moment_percent_of_weight", "brakes", "moves_with_pose", "amplitude_parameters", "even", "shifts_with", "draw_line",
    "never_negative", "vanishes_at_zero", "numbered_effect", "odd", "is_position_dependent", "reduces_to", "resists", "rotates_with",
    "rotates_about_centre",
]  # fmt: skip


class Effect(ABC):
    """Base of all effects; see the module's docstring. Effects are never instantiated:
    the class is the effect.

    excluded: it is not looked for by a diagnosis: an obstacle, for which anybody's
    touch would be taken, what `align` measures beforehand, or what looks like another
    that is looked for. each_time: it comes with how the string was picked up or handled
    before, and may differ from trial to trial. turn: of effects on hand, clocks or
    camera, those of a lower one act first, whatever the order in which they are named.
    """

    name: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    reference: ClassVar[str]
    invariants: ClassVar[tuple[Invariant, ...]] = ()
    excluded_from_search: ClassVar[bool] = False
    varies_between_trials: ClassVar[bool] = False
    order: ClassVar[int] = 0

    @staticmethod
    @abstractmethod
    def describe(values: Values) -> str:
        """The effect with these parameters as a sentence without a full stop."""

    @classmethod
    @abstractmethod
    def plot(cls, axes: Axes, values: Values) -> None:
        """A small picture of the law, in named axes."""

    @classmethod
    @cache
    def laws(cls) -> dict[str, Law]:
        """The laws this effect defines, by name."""
        return {}

    @classmethod
    def qualified_name(cls, parameter: Parameter) -> str:
        """Name of a parameter among those of all effects: the paper's own stand alone."""
        return parameter.name if parameter.symbol else f"{cls.name}.{parameter.name}"


class StringEffect(Effect):
    """An effect on the string, by laws that only ever add. Subclasses are final.

    How stiff inner forces and air resistance are is found by sampling their laws. A
    load that rises steeply with place, or with speed near rest, says so by a static
    method `bound(**parameters)`: what it adds at most to the squared frequency [1/s^2]
    and the damping rate [1/s] of a mass, each (C,).
    """

    @classmethod
    @cache
    def laws(cls) -> dict[str, Law]:
        """The laws this effect defines, by slot."""
        return {slot: getattr(cls, slot) for slot in SLOTS if hasattr(cls, slot)}

    @classmethod
    def plot(cls, axes: Axes, values: Values) -> None:
        """The effect's first law over the first of the slot's arguments that it takes,
        or the loop of what has a memory.
        """
        paper = any(p.length_power for p in cls.parameters)
        units = {p.unit: values[p.name] for p in cls.parameters}
        effect_plots.draw_law(
            axes,
            cls.laws(),
            {**values, **cls.derive_parameters(**values)},
            units,
            of_a_point=paper,
        )

    @staticmethod
    def derive_parameters(*_: Quantity, **parameters: Quantity) -> dict[str, Quantity]:
        """Quantities of the parameters alone that laws need, computed once for each
        candidate and not in the loop.
        """
        return {}


class HandEffect(Effect):
    """An effect between what the arm reports and where the grasp really is. Subclasses
    are final.

    joints(t, angles, **parameters): joint angles that really happened, and/or grasp(t,
    pose, **parameters): pose of the grasp that really happened. With joint angles at
    hand the first is used, with poses of the grasp the second. t: (K,) [s]. angles: (1
    or C, K, J) [rad]; pose: (1 or C, K, 3) [m], [m], [rad]. Parameters are (C, 1, 1).
    """

    @classmethod
    @cache
    def laws(cls) -> dict[str, Law]:
        """`joints` and `grasp`, where defined."""
        return {
            law: getattr(cls, law) for law in ("joints", "grasp") if hasattr(cls, law)
        }

    @classmethod
    def plot(cls, axes: Axes, values: Values) -> None:
        """The actual swing of a joint, dashed, beside the reported one."""
        effect_plots.draw_joint_swing(axes, cls.laws()["joints"], list(values.values()))


class ClockEffect(Effect):
    """An effect between the camera's clock and the arm's. Subclasses are final."""

    @staticmethod
    @abstractmethod
    def times(t: np.ndarray, *_: Quantity, **parameters: Quantity) -> np.ndarray:
        """Times of the arm's clock, (C, F) [s], at times t of the camera's, (F,) or (C,
        F). Parameters are (C, 1).
        """

    @classmethod
    @cache
    def laws(cls) -> dict[str, Law]:
        """`times`."""
        return {"times": cls.times}

    @classmethod
    def plot(cls, axes: Axes, values: Values) -> None:
        """The difference over time."""
        t = np.linspace(0.0, 1.0, 2)
        effect_plots.draw_line(
            axes,
            t,
            cls.times(t, **values) - t,
            "camera's clock / s",
            "arm's clock less that / s",
        )


class CameraEffect(Effect):
    """An effect between where points are and where the camera reports them. Subclasses
    are final.

    of_lens: a calibrated lens leaves nothing of it, so that a diagnosis does not look
    for it.
    """

    corrected_by_calibration: ClassVar[bool] = False

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
        """Reported points, (C, F, n, 2) [m].

        points, velocity: true ones at the frame times, (C, F, n, 2) [m], [m/s]. times:
        (F,) [s]. camera: as it is taken to be. Parameters are (C, 1, 1, 1).
        """

    @classmethod
    @cache
    def laws(cls) -> dict[str, Law]:
        """`seen`."""
        return {"seen": cls.observe}

    @classmethod
    def plot(cls, axes: Axes, values: Values) -> None:
        """A square grid as it is seen."""
        effect_plots.draw_observed_grid(axes, cls.observe, **values)


class ModelChange(Effect):
    """Something wrong with the model's own making: no law and no parameter, but another
    number of mass points.
    """

    @staticmethod
    @abstractmethod
    def points(points: int) -> int:
        """The number of mass points instead of so many."""


EffectT = TypeVar("EffectT", bound=Effect)


@cache
def numbered_effect(effect: type[EffectT], number: int) -> type[EffectT]:
    """The effect under a numbered name, so that several of a kind can be active side by
    side.
    """
    return cast(
        "type[EffectT]",
        type(
            f"{effect.__name__}{number}", (effect,), {"name": f"{effect.name}_{number}"}
        ),
    )


def amplitude_parameters(effect: type[Effect]) -> tuple[Parameter, ...]:
    """The parameters that are an effect's size: its first, and others in the same unit,
    which are other components of a vector.
    """
    return tuple(p for p in effect.parameters if p.unit == effect.parameters[0].unit)


def moment_percent_of_weight(moment: float) -> float:
    """A moment over mass per length [m3/s2] in per cent of the one that holds 100 mm of
    the string out level.
    """
    return 100 * moment / (9.81 * 0.1**2 / 2)


@cache
def is_position_dependent(effect: type[Effect]) -> bool:
    """Whether one of an effect's laws depends on where the string is."""
    where = {"x", "y"} - {parameter.name for parameter in effect.parameters}
    return any(where & set(law_arguments(law)) for law in effect.laws().values())
