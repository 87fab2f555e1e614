"""How effects draw their laws, in labelled axes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from stringcast.stages.model.camera import Camera
from stringcast.stages.model.engine.law_slots import (
    MEMORY_SLOTS,
    PROPORTIONAL_SLOTS,
    SLOTS,
    Law,
    law_arguments,
    select_arguments,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# How far arguments go in a fast cast of a soft string, by unit; stretch has none.
ARGUMENT_RANGES = {
    "1": 0.01,
    "1/s": 10.0,
    "1/m": 40.0,
    "1/(m s)": 1000.0,
    "rad": 1.0,
    "rad/s": 10.0,
}
# of the string's place and speed, and of time
ARGUMENT_RANGES |= {"m": 1.0, "m/s": 10.0, "s": 1.0}


def draw_line(axes: Axes, x: np.ndarray, y: np.ndarray, across: str, up: str) -> None:
    """Draw y over x, with zero in view and the axes named."""
    axes.plot(x, np.broadcast_to(y, np.shape(x)))
    axes.axhline(0.0, linewidth=0.5, color="0.6")
    axes.set_xlabel(across)
    axes.set_ylabel(up)


def draw_law(
    axes: Axes,
    laws: Mapping[str, Law],
    values: Mapping[str, float],
    by_unit: Mapping[str, float],
    of_a_point: bool,
) -> None:
    """Draw the first of an effect's laws, over the first argument of its slot that it
    takes, if any; of a vector both components.

    values: of parameters and what is derived of them; a parameter of the paper's that
    is not given is one. by_unit: values by their units. of_a_point: they are per mass
    point, not of the material.
    """
    if not {held for held, _, _ in MEMORY_SLOTS.values()}.isdisjoint(laws):
        draw_hysteresis(axes, laws, values, by_unit)
        return
    slot, drawn = next(iter(laws.items()))
    known = SLOTS[slot].arguments
    taken_here = [name for name in law_arguments(drawn) if name in known]
    across, length = next(iter([*taken_here, *known])), "length" in known
    reach = 1.0 if length else ARGUMENT_RANGES[known[across]]
    x = np.linspace(0.0 if length else -reach, reach, 401)
    fixed = dict.fromkeys(law_arguments(drawn), 1.0) | {
        name: 0.0 for name in taken_here if name != "length"
    }
    up = drawn(**select_arguments(drawn, {**fixed, **values, across: x}))
    belongs = (
        SLOTS[PROPORTIONAL_SLOTS[slot][0]]
        if slot in PROPORTIONAL_SLOTS
        else SLOTS[slot]
    )
    label = f"{across} / length" if length else f"{across} / ({known[across]})"
    unit = "of a mass point" if of_a_point else f"/ ({belongs.unit})"
    adds = belongs.quantity.removesuffix(" over mass per length")  # which the unit says
    for part in up if isinstance(up, tuple) else (up,):
        draw_line(
            axes,
            x,
            part * x if slot in PROPORTIONAL_SLOTS else part,
            label,
            f"{adds} {unit}",
        )


def draw_hysteresis(
    axes: Axes,
    laws: Mapping[str, Law],
    values: Mapping[str, float],
    by_unit: Mapping[str, float],
) -> None:
    """Draw what a hinge or a grasp with a memory holds, bent there and back, slowly or
    as fast as it forgets.

    As far as three times the parameter that is in the unit of its bending, else to 1;
    in four times the one in seconds.
    """
    held, moment, bends = next(
        each for each in MEMORY_SLOTS.values() if each[0] in laws
    )
    unit = SLOTS[held].unit
    bent = (
        3
        * by_unit.get(unit, 1 / 3)
        * np.interp(np.linspace(0.0, 5.0, 501), np.arange(6), [0, 1, 0, -1, 0, 1])
    )
    state, moments, lapse = 0.0, [], by_unit.get("s", 1.0) / 100
    for change in np.diff(bent, prepend=0.0):
        known = {**values, "held": state, "change": change, "dt": lapse}
        state = laws[held](**select_arguments(laws[held], known))
        moments.append(
            laws[moment](**select_arguments(laws[moment], {**values, "held": state}))
        )
    draw_line(axes, bent, np.array(moments), f"{bends} / ({unit})", "moment / (m3/s2)")


def draw_joint_swing(axes: Axes, joints: Law, values: Sequence[float]) -> None:
    """Draw what joints do while a swing there and back of all of them is reported.
    values: of the law's parameters, one for each joint or one for all.
    """
    t = np.linspace(0.0, 1.0, 201)
    reported = 0.2 * np.sin(2 * np.pi * t)
    real = joints(
        t,
        np.tile(reported[None, :, None], len(values)),
        *(np.full((1, 1, 1), value) for value in values),
    )[0]
    axes.plot(t, reported, linestyle="--", label="reported")
    axes.plot(
        t,
        real,
        label=[f"q{joint}" for joint in range(1, len(values) + 1)]
        if len(values) > 1
        else "real",
    )
    axes.set_xlabel("time / s")
    axes.set_ylabel("angle / rad")
    axes.legend()


def draw_observed_grid(
    axes: Axes, seen: Callable[..., np.ndarray], **values: float
) -> None:
    """Draw a square grid, dashed, and as a camera effect's law sees it."""
    camera = Camera(200, 200, 100.0, (99.5, 99.5), 1.0)
    lines = np.stack(
        np.meshgrid(
            np.linspace(-0.9, 0.9, 5), np.linspace(-0.9, 0.9, 41), indexing="ij"
        ),
        axis=-1,
    )
    given = {name: np.full((1, 1, 1, 1), value) for name, value in values.items()}
    for way in (lines, lines[..., ::-1]):
        bent = seen(way[None], 0 * way[None], np.zeros(1), camera, **given)[0]
        axes.plot(*way.T, color="0.7", linestyle="--", linewidth=0.5)
        axes.plot(*bent.T, color="C0")
    axes.set_aspect("equal")
    axes.set_xlabel("x / m")
    axes.set_ylabel("y / m")
