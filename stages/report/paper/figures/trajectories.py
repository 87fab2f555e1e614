"""The hand's way to different targets (Fig. 10)."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure

from stringcast.stages.report.paper.figures.shapes import boxes
from stringcast.stages.report.paper.record import LABELS, Drawn, PaperRecord
from stringcast.stages.report.picture import LIGHT, MM

COLOURS = ("after", "before", "measured")


def trajectories(record: PaperRecord, conditions: Sequence[str]) -> Drawn | None:
    """The last cast of each experiment; a dot where the hand starts."""
    there = [name for name in conditions if record.casts(name)]
    if not there:
        return None
    figure = Figure(figsize=(5.4, 4.9))
    axes = figure.subplots()
    rises = []
    for name, colour in zip(there, COLOURS, strict=False):
        hand = record.cast("hands", name, record.casts(name)[-1]).sort_values("t")
        x, y = hand["x"].to_numpy() * MM, hand["y"].to_numpy() * MM
        axes.plot(x, y, color=LIGHT[colour], label=LABELS[name])
        axes.plot(x[0], y[0], "o", color=LIGHT[colour], ms=5)
        boxes(axes, record.of("boxes", name))
        rises.append(f"{LABELS[name]}: the hand ends {abs(y[-1] - y[0]):.0f} mm {'above' if y[-1] > y[0] else 'below'}")
    axes.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal", adjustable="datalim")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper left", ncols=3)
    return Drawn(figure, f"Ways of the hand. {'; '.join(rises)} its start.")
