"""Plots of the laws of effects, in labelled axes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from stringcast.stages.model.camera import Camera
from stringcast.stages.model.engine.law_slots import (
    MEMORY_SLOTS,
    SLOTS,
    Law,
    has_memory,
    law_arguments,
    select_arguments,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LABEL_CHARACTERS = 28  # a line of the vertical label fits the height of the axes

# Range of arguments in a fast cast of a soft string, by unit.
ARGUMENT_RANGES = {
    "1": 0.01,
    "1/s": 10.0,
    "1/m": 40.0,
    "1/(m s)": 1000.0,
    "rad": 1.0,
    "rad/s": 10.0,
}
# Place and speed of the string, and time.
ARGUMENT_RANGES |= {"m": 1.0, "m/s": 10.0, "s": 1.0}


def draw_line(axes: Axes, x: np.ndarray, y: np.ndarray, across: str, up: str) -> None:
    """Draw y over x, with a line at zero and labelled axes."""
    axes.plot(x, np.broadcast_to(y, np.shape(x)))
    axes.axhline(0.0, linewidth=0.5, color="0.6")
    axes.set_xlabel(across)
    axes.set_ylabel(fill(up, LABEL_CHARACTERS))


def draw_law(
    axes: Axes,
    laws: Mapping[str, Law],
    values: Mapping[str, float],
    by_unit: Mapping[str, float],
    of_a_point: bool,
) -> None:
    """Draw an effect's first law over the first slot argument that it takes.

    Both components of a vector are drawn.

    Parameters
    ----------
    axes : matplotlib Axes
        Axes to draw in.
    laws : mapping of str to law
        The effect's laws, by slot.
    values : mapping of str to float
        Values of parameters and of derived quantities. A parameter of the paper that is
        not given is 1.
    by_unit : mapping of str to float
        Values by their units.
    of_a_point : bool
        Whether the values are per mass point instead of material properties.
    """
    if has_memory(laws):
        draw_hysteresis(axes, laws, values, by_unit)
        return
    slot, law = next(iter(laws.items()))
    units = SLOTS[slot].arguments
    argument_names = [name for name in law_arguments(law) if name in units]
    across = [*argument_names, *units][0]
    if "length" in units:
        x = np.linspace(0.0, 1.0, 401)
        label = f"{across} / length"
    else:
        reach = ARGUMENT_RANGES[units[across]]
        x = np.linspace(-reach, reach, 401)
        label = f"{across} [{units[across]}]"
    arguments: dict[str, Any] = dict.fromkeys(law_arguments(law), 1.0)
    arguments |= dict.fromkeys(set(argument_names) - {"length"}, 0.0)
    arguments |= {**values, across: x}
    y = law(**select_arguments(law, arguments))
    # The unit shows that it is over mass per length.
    quantity = SLOTS[slot].quantity.removesuffix(" over mass per length")
    unit = "of a mass point" if of_a_point else f"[{SLOTS[slot].unit}]"
    for component in y if isinstance(y, tuple) else (y,):
        draw_line(axes, x, component, label, f"{quantity} {unit}")


def draw_hysteresis(
    axes: Axes,
    laws: Mapping[str, Law],
    values: Mapping[str, float],
    by_unit: Mapping[str, float],
) -> None:
    """Draw the hysteresis loop of a hinge or a grasp with memory.

    Its bend swings over three times the parameter in the unit of the bend, or 1 if
    there is none. The five strokes take five times the parameter in seconds.
    """
    slots = [slots for slots in MEMORY_SLOTS.values() if slots[0] in laws]
    memory_slot, moment_slot, bend = slots[0]
    unit = SLOTS[memory_slot].unit
    reach = 3 * by_unit.get(unit, 1 / 3)
    turns = np.interp(np.linspace(0.0, 5.0, 501), np.arange(6), [0, 1, 0, -1, 0, 1])
    bends = reach * turns
    duration = by_unit.get("s", 1.0) / 100
    update, moment_law = laws[memory_slot], laws[moment_slot]
    memory, moments = 0.0, []
    for change in np.diff(bends, prepend=0.0):
        known = {**values, "memory": memory, "change": change, "dt": duration}
        memory = update(**select_arguments(update, known))
        known["memory"] = memory
        moments.append(moment_law(**select_arguments(moment_law, known)))
    draw_line(axes, bends, np.array(moments), f"{bend} [{unit}]", "moment [m3/s2]")


def draw_joint_swing(axes: Axes, joints: Law, values: Sequence[float]) -> None:
    """Draw the actual motion of joints for a reported sine of all of them.

    values: the law's parameters, one for each joint or one for all.
    """
    t = np.linspace(0.0, 1.0, 201)
    reported = 0.2 * np.sin(2 * np.pi * t)
    angles = np.tile(reported[None, :, None], len(values))
    parameters = [np.full((1, 1, 1), value) for value in values]
    actual = joints(t, angles, *parameters)[0]
    axes.plot(t, reported, linestyle="--", label="reported")
    names = [f"q{joint}" for joint in range(1, len(values) + 1)]
    axes.plot(t, actual, label=names if len(values) > 1 else "real")
    axes.set_xlabel("time [s]")
    axes.set_ylabel("angle / rad")
    axes.legend()


def draw_observed_grid(
    axes: Axes, observe: Callable[..., np.ndarray], **values: float
) -> None:
    """Draw a square grid, dashed, and its image by a camera effect's law."""
    camera = Camera(200, 200, 100.0, (99.5, 99.5), 1.0)
    x, y = np.linspace(-0.9, 0.9, 5), np.linspace(-0.9, 0.9, 41)
    lines = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    parameters = {name: np.full((1, 1, 1, 1), value) for name, value in values.items()}
    for straight in (lines, lines[..., ::-1]):
        points = straight[None]
        bent = observe(points, 0 * points, np.zeros(1), camera, **parameters)[0]
        axes.plot(*straight.T, color="0.7", linestyle="--", linewidth=0.5)
        axes.plot(*bent.T, color="C0")
    axes.set_aspect("equal")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
