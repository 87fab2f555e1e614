"""What an effect on the string is: scalar laws that only ever add.

An effect is a class in one file of `stages/model/effects/`. Its laws are static methods
named after the slots below. A law takes, by name, any of its slot's arguments and any
parameter (its own, or one of the paper's); it is written for one candidate and one place,
in arithmetic and numpy functions without branches, and returns what it adds. Everything
is per mass per length, so that a law knows nothing of mass points:

slot            arguments                                          adds
tension         stretch [1], rate [1/s], s [m]                     axial force over mass per length [m^2/s^2]
moment          curvature [1/m], rate [1/(m s)], s [m]             bending moment over mass per length [m^3/s^2]
grasp_moment    angle [rad], rate [rad/s]                          moment at the grasp over mass per length [m^3/s^2]
load            x, y [m], vx, vy [m/s], tx, ty [1], s [m], t [s]   force over nominal mass, (x, y) [m/s^2]
acceleration    x, y [m], t [s]                                    acceleration whatever the mass, (x, y) [m/s^2]
rest_curvature  s [m]                                              curvature at rest [1/m]
density         s [m], length [m]                                  mass per length over its nominal value, less 1 [1]
tip_mass        length [m]                                         mass at the tip over nominal mass per length [m]
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import ClassVar

from stages.model.parameter import Parameter

SLOTS: dict[str, tuple[str, ...]] = {
    "tension": ("stretch", "rate", "s"),
    "moment": ("curvature", "rate", "s"),
    "grasp_moment": ("angle", "rate"),
    "load": ("x", "y", "vx", "vy", "tx", "ty", "s", "t"),
    "acceleration": ("x", "y", "t"),
    "rest_curvature": ("s",),
    "density": ("s", "length"),
    "tip_mass": ("length",),
}


class StringEffect:
    """Base of the effects on the string. Subclasses are final; see the module's docstring."""

    name: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]] = ()

    @classmethod
    def laws(cls) -> dict[str, Callable[..., object]]:
        """The laws this effect defines, by slot."""
        return {slot: getattr(cls, slot) for slot in SLOTS if hasattr(cls, slot)}

    @classmethod
    def qualified(cls, parameter: Parameter) -> str:
        """Name of a parameter among those of all effects: the paper's own stand alone."""
        return parameter.name if parameter.symbol else f"{cls.name}.{parameter.name}"


def arguments(law: Callable[..., object]) -> tuple[str, ...]:
    """Names of a law's arguments, in order."""
    return tuple(inspect.signature(law).parameters)
