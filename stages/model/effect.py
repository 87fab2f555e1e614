"""What an effect is: one physical cause, one class, one file, with all that anybody asks of it.

A file of `stages/model/effects/` (or of a folder named in STRINGCAST_EFFECTS) holds one class
and is called like it. From it come the name, the parameters with units and bounds, the law,
its sentence and picture for a report, its reference, and the symmetries that tests hold it
to. An effect whose parameters are at their start is absent.

There is a base class for each place where something can be other than the paper says: on the
string (`StringEffect`), in the hand (`HandEffect`), in the camera (`CameraEffect`), between
their clocks (`ClockEffect`), or in the model's own making (`ModelChange`).

The laws of the string run in the hot loop. They are static methods named after the slots
below, take by name any of their slot's arguments and any parameter (their own, what they
derive from them, or one of the paper's), and are written for one candidate and one place, in
arithmetic and numpy functions without branches. They return what they add. Everything is
per mass per length, so that a law knows nothing of mass points.

A law with memory is two: `held` says what a hinge holds after its curvature has changed by `change`
within `dt`, from what it held before, and `held_moment` the moment of that; `grasp_held` and
`grasp_held_moment` say it of the grasp and its angle. A string that hangs at rest holds nothing, for the
swings that die down there leave it on neither side; one that is let go elsewhere was pulled there slowly,
and holds `held(held=0, change=curvature - curvature_at_rest, dt=inf)`.
"""

from __future__ import annotations

import inspect
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar, cast

import numpy as np

from stringcast.stages.model.parameter import Parameter
from stringcast.stages.model.symmetry import Symmetry

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from stringcast.stages.model.camera import Camera
    from stringcast.stages.model.model import Model

Quantity = Any  # a float in the hot loop, elsewhere an array over candidates and places
Law = Callable[..., Quantity]


@dataclass(frozen=True)
class Slot:
    """A place for laws in the string's equation of motion. unit: of what they add; arguments: units by name."""

    adds: str
    unit: str
    arguments: Mapping[str, str]


PLACE = {"x": "m", "y": "m"}
SLOTS: dict[str, Slot] = {
    "tension": Slot("axial force over mass per length", "m2/s2", {"stretch": "1", "rate": "1/s", "s": "m"}),
    "moment": Slot("bending moment over mass per length", "m3/s2", {"curvature": "1/m", "rate": "1/(m s)", "s": "m"}),
    # for moments that are far from linear and can be steep: implicit steps average them as they are
    "hinge_stiffness": Slot("bending moment over mass per length, per curvature", "m4/s2", {"curvature": "1/m"}),
    "hinge_drag": Slot("bending moment over mass per length, per rate of curvature", "m4/s", {"rate": "1/(m s)"}),
    # for hinges with a memory: what one holds after its curvature has changed, and the moment that goes with it
    "held": Slot("what a hinge holds, from what it held", "1/m", {"held": "1/m", "change": "1/m", "dt": "s"}),
    "held_moment": Slot("bending moment over mass per length", "m3/s2", {"held": "1/m"}),
    "grasp_held": Slot("what the grasp holds, from what it held", "rad", {"held": "rad", "change": "rad", "dt": "s"}),
    "grasp_held_moment": Slot("moment at the grasp over mass per length", "m3/s2", {"held": "rad"}),
    "grasp_moment": Slot("moment at the grasp over mass per length", "m3/s2", {"angle": "rad", "rate": "rad/s"}),
    # v is the string's velocity, u that through the air, (tx, ty) the string's direction towards the tip, dt the step
    "load": Slot(
        "force over nominal mass, (x, y)",
        "m/s2",
        PLACE
        | {"vx": "m/s", "vy": "m/s", "ux": "m/s", "uy": "m/s", "tx": "1", "ty": "1", "s": "m", "t": "s", "dt": "s"},
    ),
    "acceleration": Slot("acceleration whatever the mass, (x, y)", "m/s2", PLACE | {"t": "s"}),
    "flow": Slot("velocity of the air, (x, y)", "m/s", PLACE | {"t": "s"}),
    "rest_curvature": Slot("curvature at rest", "1/m", {"s": "m", "length": "m"}),
    "density": Slot("mass per length over its nominal value, less 1", "1", {"s": "m", "length": "m"}),
    "tip_mass": Slot("mass at the tip over nominal mass per length", "m", {"length": "m"}),
    "tip_length": Slot("string at the tip beyond its length, of its mass and in its air", "m", {"length": "m"}),
    # for a string that does not begin where the grasp is said to be; measured points are told from there all the same
    "hidden_length": Slot("free string before the stated grasp", "m", {}),
    "grasp_offset": Slot("where the free string begins, from the stated grasp, (along, across)", "m", {}),
}

# Slots whose value times one of its arguments belongs to another slot: which, and the argument.
PER = {"hinge_stiffness": ("moment", "curvature"), "hinge_drag": ("moment", "rate")}

# What is held, by the slot that its moment belongs to: the slots of the state and of its moment, and what it follows.
HELD = {
    "moment": ("held", "held_moment", "curvature"),
    "grasp_moment": ("grasp_held", "grasp_held_moment", "angle"),
}


class Effect(ABC):
    """Base of all effects; see the module's docstring. Effects are never instantiated: the class is the effect.

    told: it is not looked for by a diagnosis: an obstacle, for which anybody's touch would be taken, or what `align`
    measures beforehand. of_string: it is of the thing itself, and not of how a simulation divides it.
    """

    name: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    reference: ClassVar[str]
    symmetries: ClassVar[tuple[Symmetry, ...]] = ()
    told: ClassVar[bool] = False
    of_string: ClassVar[bool] = True

    @staticmethod
    @abstractmethod
    def words(values: Mapping[str, float]) -> str:
        """What is so, in a sentence without a full stop. values: of its parameters, by name."""

    @staticmethod
    def plausible(values: Mapping[str, float]) -> bool:
        """Whether such values can be what the words say, and not something else in their guise. By own names."""
        return True

    @classmethod
    @abstractmethod
    def plot(cls, axes: Axes, values: Mapping[str, float]) -> None:
        """A small picture of the law. values: of its parameters, by name."""

    @classmethod
    @abstractmethod
    def join(cls, model: Model) -> Model:
        """The model with this effect at work."""

    @classmethod
    @cache
    def laws(cls) -> dict[str, Law]:
        """The laws this effect defines, by name."""
        return {}

    @classmethod
    def qualified(cls, parameter: Parameter) -> str:
        """Name of a parameter among those of all effects: the paper's own stand alone."""
        return parameter.name if parameter.symbol else f"{cls.name}.{parameter.name}"


class StringEffect(Effect):
    """An effect on the string, by laws that only ever add. Subclasses are final.

    How stiff inner forces and air resistance are is found by sampling their laws. A load that
    rises steeply with place, or with speed near rest, says so by a static method
    `bound(**parameters)`: what it adds at most to the squared frequency [1/s^2] and the damping
    rate [1/s] of a mass, each (C,).
    """

    @classmethod
    @cache
    def laws(cls) -> dict[str, Law]:
        """The laws this effect defines, by slot."""
        return {slot: getattr(cls, slot) for slot in SLOTS if hasattr(cls, slot)}

    @staticmethod
    def derived(*_: Quantity, **parameters: Quantity) -> dict[str, Quantity]:
        """What laws need of the parameters alone, computed once for each candidate and not in the loop."""
        return {}

    @classmethod
    def join(cls, model: Model) -> Model:
        """The model whose string has this effect."""
        return replace(model, string=replace(model.string, effects=(*model.string.effects, cls)))


class HandEffect(Effect):
    """An effect between what the arm reports and where the grasp really is. Subclasses are final.

    joints(t, angles, **parameters): joint angles that really happened, and/or
    grasp(t, pose, **parameters): pose of the grasp that really happened. With joint angles at
    hand the first is used, with poses of the grasp the second. t: (K,) [s]. angles: (1 or C, K, J)
    [rad]; pose: (1 or C, K, 3) [m], [m], [rad]. Parameters are (C, 1, 1).
    """

    @classmethod
    @cache
    def laws(cls) -> dict[str, Law]:
        """`joints` and `grasp`, where defined."""
        return {law: getattr(cls, law) for law in ("joints", "grasp") if hasattr(cls, law)}

    @classmethod
    def join(cls, model: Model) -> Model:
        """The model whose hand has this effect."""
        return replace(model, hand_effects=(*model.hand_effects, cls))


class ClockEffect(Effect):
    """An effect between the camera's clock and the arm's. Subclasses are final."""

    @staticmethod
    @abstractmethod
    def times(t: np.ndarray, *_: Quantity, **parameters: Quantity) -> np.ndarray:
        """Times of the arm's clock, (C, F) [s], at times t of the camera's, (F,) or (C, F). Parameters are (C, 1)."""

    @classmethod
    @cache
    def laws(cls) -> dict[str, Law]:
        """`times`."""
        return {"times": cls.times}

    @classmethod
    def join(cls, model: Model) -> Model:
        """The model whose clocks have this effect."""
        return replace(model, clock_effects=(*model.clock_effects, cls))


class CameraEffect(Effect):
    """An effect between where points are and where the camera reports them. Subclasses are final.

    of_lens: a calibrated lens leaves nothing of it, so that a diagnosis does not look for it.
    """

    of_lens: ClassVar[bool] = False

    @staticmethod
    @abstractmethod
    def seen(
        points: np.ndarray,
        velocity: np.ndarray,
        times: np.ndarray,
        camera: Camera,
        *_: Quantity,
        **parameters: Quantity,
    ) -> np.ndarray:
        """Reported points, (C, F, n, 2) [m].

        points, velocity: true ones at the frame times, (C, F, n, 2) [m], [m/s]. times: (F,)
        [s]. camera: as it is taken to be. Parameters are (C, 1, 1, 1).
        """

    @classmethod
    @cache
    def laws(cls) -> dict[str, Law]:
        """`seen`."""
        return {"seen": cls.seen}

    @classmethod
    def join(cls, model: Model) -> Model:
        """The model whose camera has this effect."""
        return replace(model, camera_effects=(*model.camera_effects, cls))


class ModelChange(Effect):
    """Something wrong with the model's own making: no law and no parameter, but another model (`join`)."""


Made = TypeVar("Made", bound=Effect)


@cache
def another(effect: type[Made], number: int) -> type[Made]:
    """The effect once more, its name with a number: several of a kind can then be at work side by side."""
    return cast("type[Made]", type(f"{effect.__name__}{number}", (effect,), {"name": f"{effect.name}_{number}"}))


@cache
def arguments(law: Callable[..., object]) -> tuple[str, ...]:
    """Names of a law's arguments, in order."""
    return tuple(inspect.signature(law).parameters)


def components(effect: type[Effect]) -> tuple[Parameter, ...]:
    """The parameters that are an effect's size: its first, and others in the same unit, which are other components of a
    vector."""
    return tuple(p for p in effect.parameters if p.unit == effect.parameters[0].unit)


@cache
def placed(effect: type[Effect]) -> bool:
    """Whether one of an effect's laws depends on where the string is."""
    return any({"x", "y"} & set(arguments(law)) for law in effect.laws().values())


def taken(law: Callable[..., object], known: Mapping[str, Quantity]) -> dict[str, Quantity]:
    """Those of the known arguments that a law takes."""
    return {name: known[name] for name in arguments(law) if name in known}
