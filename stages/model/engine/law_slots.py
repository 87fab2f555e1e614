"""Slots for laws in the string's equation of motion, with arguments and units."""

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
    """A slot for laws in the string's equation of motion.

    Parameters
    ----------
    quantity : str
        Quantity to which laws contribute.
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
    # For strongly nonlinear moments, which can be steep: implicit steps average them.
    "hinge_stiffness": Slot(
        "bending moment over mass per length, per curvature",
        "m4/s2",
        {"curvature": "1/m"},
    ),
    # For hinges with memory: its state after a change of curvature, and its moment.
    "hinge_memory": Slot(
        "updated memory of a hinge",
        "1/m",
        {"memory": "1/m", "change": "1/m", "dt": "s"},
    ),
    "hinge_memory_moment": Slot(
        "bending moment over mass per length", "m3/s2", {"memory": "1/m"}
    ),
    "grasp_memory": Slot(
        "updated memory of the grasp",
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
    # v: velocity of the string. u: velocity relative to the air. (tx, ty): direction of
    # the string towards the tip. dt: step.
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
        "acceleration independent of mass, (x, y)", "m/s2", {**POSITION_UNITS, "t": "s"}
    ),
    "flow": Slot("velocity of the air, (x, y)", "m/s", {**POSITION_UNITS, "t": "s"}),
    "rest_curvature": Slot("curvature at rest", "1/m", {"s": "m", "length": "m"}),
    "density": Slot(
        "relative excess of mass per length over its nominal value",
        "1",
        {"s": "m", "length": "m"},
    ),
    "tip_mass": Slot(
        "mass at the tip over nominal mass per length", "m", {"length": "m"}
    ),
    "tip_length": Slot(
        "additional length at the tip, which has mass and drag",
        "m",
        {"length": "m"},
    ),
    # For a string that does not begin at the stated grasp. Arc lengths of measured
    # points still count from the stated grasp.
    "hidden_length": Slot("free string before the stated grasp", "m", {}),
    "grasp_offset": Slot(
        "beginning of the free string from the stated grasp, (along, across)", "m", {}
    ),
}

# Rows of parameters if the beginning of the string may move: free length over stated
# length, and one over the length of a segment.
FREE_LENGTH_ROWS = ("free_length_ratio", "per_segment")

# By the slot to which the moment of a memory belongs: slots of its state and moment,
# and the bend that it follows.
MEMORY_SLOTS = {
    "moment": ("hinge_memory", "hinge_memory_moment", "curvature"),
    "grasp_moment": ("grasp_memory", "grasp_memory_moment", "angle"),
}


def has_memory(laws: Mapping[str, Law]) -> bool:
    """Return whether one of the laws, by slot, has memory."""
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
