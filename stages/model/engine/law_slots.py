"""Places for laws in the string's equation of motion, with arguments and units."""

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
    """A place for laws in the string's equation of motion.

    Parameters
    ----------
    quantity : str
        What laws add there.
    unit : str
        Its unit.
    arguments : mapping of str to str
        Units of the arguments that a law may take, by name.
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
    # for moments far from linear, which can be steep: implicit steps average them
    "hinge_stiffness": Slot(
        "bending moment over mass per length, per curvature",
        "m4/s2",
        {"curvature": "1/m"},
    ),
    # for hinges with a memory: its state after the curvature has changed, and its
    # moment
    "hinge_memory": Slot(
        "memory of a hinge, from what it was",
        "1/m",
        {"memory": "1/m", "change": "1/m", "dt": "s"},
    ),
    "hinge_memory_moment": Slot(
        "bending moment over mass per length", "m3/s2", {"memory": "1/m"}
    ),
    "grasp_memory": Slot(
        "memory of the grasp, from what it was",
        "rad",
        {"memory": "rad", "change": "rad", "dt": "s"},
    ),
    "grasp_memory_moment": Slot(
        "moment at the grasp over mass per length", "m3/s2", {"memory": "rad"}
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
        {
            **POSITION_UNITS,
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
        "acceleration whatever the mass, (x, y)", "m/s2", {**POSITION_UNITS, "t": "s"}
    ),
    "flow": Slot("velocity of the air, (x, y)", "m/s", {**POSITION_UNITS, "t": "s"}),
    "rest_curvature": Slot("curvature at rest", "1/m", {"s": "m", "length": "m"}),
    "density": Slot(
        "mass per length over its nominal value, less 1",
        "1",
        {"s": "m", "length": "m"},
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
    # are counted from there all the same
    "hidden_length": Slot("free string before the stated grasp", "m", {}),
    "grasp_offset": Slot(
        "where the free string begins, from the stated grasp, (along, across)", "m", {}
    ),
}

# Rows of parameters of strings that begin elsewhere than stated: free length over that
# stated, and one over a segment's.
FREE_LENGTH_ROWS = ("free_length_ratio", "per_segment")

# Memory, by the slot that its moment belongs to: the slots of the state and of its
# moment, and the bending that it follows.
MEMORY_SLOTS = {
    "moment": ("hinge_memory", "hinge_memory_moment", "curvature"),
    "grasp_moment": ("grasp_memory", "grasp_memory_moment", "angle"),
}


def has_memory(laws: Mapping[str, Law]) -> bool:
    """Return whether one of the laws, by slot, keeps a memory."""
    return any(memory in laws for memory, _, _ in MEMORY_SLOTS.values())


@cache
def law_arguments(law: Callable[..., object]) -> tuple[str, ...]:
    """Return the names of a law's arguments, in order."""
    return tuple(inspect.signature(law).parameters)


def select_arguments(
    law: Callable[..., object], known: Mapping[str, Quantity]
) -> dict[str, Quantity]:
    """Select the known arguments that a law takes."""
    return {name: known[name] for name in law_arguments(law) if name in known}
