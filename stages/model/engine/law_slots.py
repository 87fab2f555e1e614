"""Where laws have their place in the string's equation of motion: what they add there,
of which arguments.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

Quantity = Any  # a float in the hot loop, elsewhere an array over candidates and places
Law = Callable[..., Quantity]


@dataclass(frozen=True)
class Slot:
    """A place for laws in the string's equation of motion. unit: of what they add;
    arguments: units by name.
    """

    quantity: str
    unit: str
    arguments: Mapping[str, str]


POSITION_UNITS = {"x": "m", "y": "m"}
SLOTS: dict[str, Slot] = {
    "tension": Slot(
        "axial force over mass per length",
        "m2/s2",
        {"stretch": "1", "rate": "1/s", "s": "m"},
    ),
    "moment": Slot(
        "bending moment over mass per length",
        "m3/s2",
        {"curvature": "1/m", "rate": "1/(m s)", "s": "m"},
    ),
    # for moments that are far from linear and can be steep: implicit steps average them
    # as they are
    "hinge_stiffness": Slot(
        "bending moment over mass per length, per curvature",
        "m4/s2",
        {"curvature": "1/m"},
    ),
    # for hinges with a memory: what one holds after its curvature has changed, and the
    # moment that goes with it
    "held": Slot(
        "what a hinge holds, from what it held",
        "1/m",
        {"held": "1/m", "change": "1/m", "dt": "s"},
    ),
    "held_moment": Slot(
        "bending moment over mass per length", "m3/s2", {"held": "1/m"}
    ),
    "grasp_held": Slot(
        "what the grasp holds, from what it held",
        "rad",
        {"held": "rad", "change": "rad", "dt": "s"},
    ),
    "grasp_held_moment": Slot(
        "moment at the grasp over mass per length", "m3/s2", {"held": "rad"}
    ),
    "grasp_moment": Slot(
        "moment at the grasp over mass per length",
        "m3/s2",
        {"angle": "rad", "rate": "rad/s"},
    ),
    # v is the string's velocity, u that through the air, (tx, ty) the string's
    # direction towards the tip, dt the step
    "load": Slot(
        "force over nominal mass, (x, y)",
        "m/s2",
        POSITION_UNITS
        | {
            "vx": "m/s",
            "vy": "m/s",
            "ux": "m/s",
            "uy": "m/s",
            "tx": "1",
            "ty": "1",
            "s": "m",
            "t": "s",
            "dt": "s",
        },
    ),
    "acceleration": Slot(
        "acceleration whatever the mass, (x, y)", "m/s2", POSITION_UNITS | {"t": "s"}
    ),
    "flow": Slot("velocity of the air, (x, y)", "m/s", POSITION_UNITS | {"t": "s"}),
    "rest_curvature": Slot("curvature at rest", "1/m", {"s": "m", "length": "m"}),
    "density": Slot(
        "mass per length over its nominal value, less 1", "1", {"s": "m", "length": "m"}
    ),
    "tip_mass": Slot(
        "mass at the tip over nominal mass per length", "m", {"length": "m"}
    ),
    "tip_length": Slot(
        "string at the tip beyond its length, of its mass and in its air",
        "m",
        {"length": "m"},
    ),
    # for a string that does not begin where the grasp is said to be; measured points
    # are told from there all the same
    "hidden_length": Slot("free string before the stated grasp", "m", {}),
    "grasp_offset": Slot(
        "where the free string begins, from the stated grasp, (along, across)", "m", {}
    ),
}

# Slots whose value times one of its arguments belongs to another slot: which, and the
# argument.
PROPORTIONAL_SLOTS = {"hinge_stiffness": ("moment", "curvature")}

# Rows of parameters of strings that begin elsewhere than stated: length over that
# stated, and one over a segment's.
FREE_LENGTH_ROWS = ("longer", "per_segment")

# What is held, by the slot that its moment belongs to: the slots of the state and of
# its moment, and what it follows.
MEMORY_SLOTS = {
    "moment": ("held", "held_moment", "curvature"),
    "grasp_moment": ("grasp_held", "grasp_held_moment", "angle"),
}


@cache
def law_arguments(law: Callable[..., object]) -> tuple[str, ...]:
    """Names of a law's arguments, in order."""
    return tuple(inspect.signature(law).parameters)


def select_arguments(
    law: Callable[..., object], known: Mapping[str, Quantity]
) -> dict[str, Quantity]:
    """The known arguments that a law takes."""
    return {name: known[name] for name in law_arguments(law) if name in known}
