"""Charts of a diagnosis: search, laws of effects, and unexplained displacement."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from stringcast.stages.common import MM_PER_M
from stringcast.stages.model.effect import Effect
from stringcast.stages.report.charts.axes import add_legend_above, new_axes
from stringcast.stages.report.formatting import (
    effect_title,
    format_gain,
    format_mm,
    format_ms,
)
from stringcast.stages.report.records import MAX_DRAWN_TRIALS, DiagnosisRecord
from stringcast.stages.report.theme import MS_PER_S, Picture, svg_picture

MAX_BARS = 14
LONGEST_ARROW_IN = 0.28
ARROW_STYLE: dict[str, Any] = {
    "angles": "uv",  # directions in the plane, independent of the scales of the axes
    "scale_units": "inches",
    "width": 0.0035,
    "headwidth": 4.5,
    "color": "target",
}


# --- effects
def law_picture(effect: type[Effect], values: Mapping[str, float]) -> Picture:
    """Draw the law of an effect; `values` has short parameter names."""
    figure, axes = new_axes(3.4, 2.5)
    effect.plot(axes, values)
    for line in axes.lines:
        if line.get_color() in ("0.6", "0.7"):  # this grey has no dark version
            line.set_color("axis")
    for arrows in axes.collections:
        arrows.set_facecolor("after")
    words = f"The law of {effect_title(effect.name)}: {effect.describe(values)}."
    return svg_picture(figure, words)


def screening_pictures(record: DiagnosisRecord) -> list[tuple[str, Picture]]:
    """Draw the predicted gains of effects at each step of the search.

    Each picture has the causes in the model as its title. Steps from causes that were
    dropped later are omitted.
    """
    chosen = set(record.extension.get("effects", ()))
    named = record.diagnosis.causes["effect"]
    pictures = []
    for context, rows in record.diagnosis.screening.groupby("context", sort=False):
        if context and not set(filter(None, context.split(" + "))) < chosen:
            continue
        ranked = rows.sort_values("predicted_gain", ascending=False, kind="stable")
        best = ranked.head(MAX_BARS)
        names = [effect_title(name) for name in best["effect"]]
        gains = best["predicted_gain"].to_numpy()
        colours = np.where(best["effect"].isin(named), "after", "axis")
        figure, axes = new_axes(5.4, 0.7 + 0.23 * len(best))
        bars = axes.barh(names, gains, height=0.7, color=colours.tolist())
        texts = [format_gain(gain) for gain in gains]
        axes.bar_label(bars, texts, padding=4, fontsize=8, color="soft")
        right = 1.15 * max(gains.max(), 1.0)
        axes.set(xlabel="predicted gain of the log-likelihood", xlim=(0, right))
        axes.grid(visible=False, axis="y")
        axes.invert_yaxis()
        words = f"Predicted gains of effects; the largest is {texts[0]} of {names[0]}."
        pictures.append((effect_title(context), svg_picture(figure, words)))
    return pictures


# --- the unexplained displacement
def unexplained_picture(record: DiagnosisRecord) -> Picture | None:
    """Draw the unexplained displacement over time and arc length in each trial."""
    table = record.diagnosis.missing
    if table.empty:
        return None
    size = np.hypot(table["x"], table["y"])
    largest = size.groupby(table["trial"]).max().sort_values(ascending=False)
    rows = table[table["trial"].isin(largest.index[:MAX_DRAWN_TRIALS])].groupby("trial")
    figure = Figure(figsize=(6.0, 0.7 + 1.25 * len(rows)))
    panels = figure.subplots(len(rows), 1, sharex=True, sharey=True, squeeze=False)
    scale = float(size.max()) / LONGEST_ARROW_IN
    for axes, (trial, points) in zip(panels[:, 0], rows, strict=True):
        places = points["t"] * MS_PER_S, points["s"] * MM_PER_M
        axes.plot(*places, ".", ms=1.5, color="axis")
        axes.quiver(*places, points["x"], points["y"], scale=scale, **ARROW_STYLE)
        axes.margins(0.06, 0.3)
        axes.set_ylabel("s [mm]")
        axes.set_title(trial, loc="right", color="soft", fontsize=9)
    axes.set_xlabel("time [ms]")
    top = table.loc[size.idxmax()]
    words = (
        f"The unexplained displacement of the string over time in {len(rows)} trials; "
        f"at most {format_mm(size.max(), 1)} in trial {top['trial']} at "
        f"{format_ms(top['t'])}."
    )
    return svg_picture(figure, words)


# --- the proposed motion
HYPOTHESIS_STYLES = (
    ("after", "-"),
    ("before", "--"),
    ("measured", "-."),
    ("target", ":"),
)


def proposal_picture(record: DiagnosisRecord) -> Picture | None:
    """Draw the strings predicted by the hypotheses when they differ most.

    To their right, draw the largest distance along the string from the likeliest
    hypothesis over time.
    """
    table = record.diagnosis.predicted
    if table.empty:
        return None
    names = list(table["hypothesis"].unique())  # the likeliest first
    table = table.assign(position=table["x"] + 1j * table["y"])
    positions = table.pivot(index=["t", "s"], columns="hypothesis", values="position")
    difference = positions.sub(positions[names[0]], axis=0).abs()
    distance = difference.groupby("t").max()[names[1:]] * MM_PER_M
    largest = distance.max()
    t = float(distance[largest.idxmin()].idxmax())

    figure = Figure(figsize=(7.2, 3.2))
    left, right = figure.subplots(1, 2)
    for name, (colour, dashes) in zip(names, HYPOTHESIS_STYLES, strict=False):
        string = positions.loc[t, name].to_numpy() * MM_PER_M
        style: dict[str, Any] = {"ls": dashes, "marker": ".", "ms": 4, "color": colour}
        left.plot(string.real, string.imag, label=effect_title(name), **style)
        if name in distance:
            right.plot(distance.index * MS_PER_S, distance[name], dashes, color=colour)
    left.set(xlabel="x [mm]", ylabel="y [mm]", title=f"at {format_ms(t)}")
    left.set(aspect="equal", adjustable="datalim")
    floor = record.diagnosis.residuals["sigma"].median() * MM_PER_M
    right.axhline(floor, color="axis", ls=":", lw=1, label="noise floor")
    right.axvline(t * MS_PER_S, color="axis", lw=1)
    right.set(xlabel="time [ms]", ylabel="largest distance [mm]", ylim=(0, None))
    right.legend()
    add_legend_above(figure, 4)
    sizes = [f"{effect_title(name)} {size:.1f} mm" for name, size in largest.items()]
    words = (
        f"The proposed motion at {format_ms(t)}; largest distances from "
        f"{effect_title(names[0])}: {', '.join(sizes)}."
    )
    return svg_picture(figure, words)
