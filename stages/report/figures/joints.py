"""What the joints were told and what they did."""

from __future__ import annotations

import numpy as np

from stringcast.data.artifacts import JOINTS
from stringcast.stages.report.picture import LIGHT, MM, Picture, framed, vector
from stringcast.stages.report.record import Cast

COLOURS = (LIGHT["after"], LIGHT["before"], LIGHT["measured"])


def joints(cast: Cast) -> Picture | None:
    """Above, the angles commanded (dashed) and measured; below, their difference."""
    commanded, measured = cast.motion.commands, cast.trial.arm
    if measured.empty:
        return None
    figure = framed(5.4, 3.7, left=0.85)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=[3, 2])
    behind = []
    for joint, colour in zip(JOINTS, COLOURS, strict=True):
        wanted = np.interp(measured["t"], commanded["t"], commanded[joint])
        away = np.degrees(measured[joint] - wanted)
        top.plot(measured["t"] * MM, np.degrees(measured[joint]), color=colour, label=joint)
        top.plot(measured["t"] * MM, np.degrees(wanted), color=LIGHT["ink"], lw=0.9, ls=(0, (3, 2)))
        bottom.plot(measured["t"] * MM, away, color=colour)
        behind.append(f"{joint} {np.abs(away).max():.1f}°")
    top.plot([], [], color=LIGHT["ink"], lw=0.9, ls=(0, (3, 2)), label="commanded")
    top.set_ylabel("angle [°]")
    bottom.set(xlabel="time [ms]", ylabel="measured −\ncommanded [°]")
    figure.legend(*top.get_legend_handles_labels(), loc="upper left", ncols=4)
    return vector(figure, f"Joint angles, commanded and measured; largest differences {', '.join(behind)}.")
