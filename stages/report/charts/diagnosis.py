"""Charts of a diagnosis: the search, the laws found, and what remains unexplained."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from stringcast.stages.model.effect import Effect
from stringcast.stages.report.charts.axes import add_legend_above, label_bars, new_axes
from stringcast.stages.report.formatting import (
    effect_title,
    format_gain,
    format_mm,
    format_ms,
)
from stringcast.stages.report.page import Chart, Line
from stringcast.stages.report.records import MAX_DRAWN_TRIALS, DiagnosisRecord
from stringcast.stages.report.theme import MM_PER_M, Picture, svg_picture

MAX_BARS = 14
LONGEST_ARROW_IN = 0.28


# --- effects
def law_picture(effect: type[Effect], values: Mapping[str, float]) -> Picture:
    """Draw the law of an effect at the values of its parameters, by their short names."""
    figure, axes = new_axes(3.4, 2.5)
    effect.plot(axes, values)
    for line in axes.lines:
        if line.get_color() in (
            "0.6",
            "0.7",
        ):  # effects draw grey, which has no dark side
            line.set_color("axis")
    for arrows in axes.collections:
        arrows.set_facecolor("after")
    words = f"The law of {effect_title(effect.name)}: {effect.describe(values)}."
    return svg_picture(figure, words)


def screening_pictures(record: DiagnosisRecord) -> list[tuple[str, Picture]]:
    """Draw the predicted gains of effects at each step of the search.

    Steps that started from causes that were dropped later are left out.

    Returns
    -------
    list of (context, picture)
        The context names the causes that were in the model.
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
        colours = np.where(
            best["effect"].isin(named), "after", "axis"
        )
        figure, axes = new_axes(5.4, 0.7 + 0.23 * len(best))
        bars = axes.barh(names, gains, height=0.7, color=colours.tolist())
        label_bars(axes, bars, gains)
        right = 1.15 * max(gains.max(), 1.0)
        axes.set(xlabel="predicted gain of the log-likelihood", xlim=(0, right))
        axes.grid(visible=False, axis="y")
        axes.invert_yaxis()
        largest = ", ".join(
            f"{names[i]} {format_gain(gain)}" for i, gain in enumerate(gains[:3])
        )
        words = f"Predicted gains of effects, the largest first: {largest}."
        pictures.append((effect_title(context), svg_picture(figure, words)))
    return pictures


def similarity_matrix(record: DiagnosisRecord) -> Picture | None:
    """Draw a cell for each pair of effects, the darker the more similar they are."""
    table = record.diagnosis.likeness
    if table.empty:
        return None
    names = list(dict.fromkeys([*table["other"], *table["effect"]]))
    labels = [effect_title(name) for name in names]
    figure, axes = new_axes(5.4, 1.6 + 0.34 * len(names))
    for row in table.itertuples():
        x, y = sorted((names.index(row.effect), names.index(row.other)))
        axes.add_patch(
            Rectangle(
                (x - 0.48, y - 0.46),
                0.96,
                0.92,
                lw=0,
                facecolor="after",
                alpha=0.75 * row.cosine**2,
            )
        )
        axes.text(x, y, f"{row.cosine:.2f}", ha="center", va="center", fontsize=8)
    count = len(names)
    axes.set(xlim=(-0.5, count - 1.5), ylim=(count - 0.5, 0.5))
    axes.set_xticks(
        np.arange(count - 1),
        labels[:-1],
        rotation=40,
        ha="right",
        rotation_mode="anchor",
    )
    axes.set_yticks(np.arange(1, count), labels[1:])
    axes.grid(visible=False)
    top = table.loc[table["cosine"].idxmax()]
    pair = f"{effect_title(top['effect'])} and {effect_title(top['other'])}"
    words = f"Similarity of {count} effects in these data; largest for {pair}, {top['cosine']:.2f}."
    return svg_picture(figure, words)


# --- the unexplained displacement
def unexplained_picture(record: DiagnosisRecord) -> Picture | None:
    """Draw the unexplained displacement over time and arc length, a row for each trial."""
    table = record.diagnosis.missing
    if table.empty:
        return None
    size = np.hypot(table["x"], table["y"])
    largest = size.groupby(table["trial"]).max().sort_values(ascending=False)
    rows = table[table["trial"].isin(largest.index[:MAX_DRAWN_TRIALS])].groupby("trial")
    figure = Figure(figsize=(6.0, 0.7 + 1.25 * len(rows)))
    panels = figure.subplots(len(rows), 1, sharex=True, sharey=True, squeeze=False)
    # the angles of arrows are those in the plane, whatever the scales of the axes
    for axes, (trial, points) in zip(panels[:, 0], rows, strict=True):
        places = points["t"] * MM_PER_M, points["s"] * MM_PER_M
        axes.plot(*places, ".", ms=1.5, color="axis")
        axes.quiver(
            *places,
            points["x"],
            points["y"],
            angles="uv",
            scale_units="inches",
            scale=float(size.max()) / LONGEST_ARROW_IN,
            width=0.0022,
            color="target",
        )
        axes.margins(0.06, 0.3)
        axes.set_ylabel("s [mm]")
        axes.text(
            1.0,
            1.0,
            trial,
            transform=axes.transAxes,
            ha="right",
            va="bottom",
            color="soft",
        )
    axes.set_xlabel("time [ms]")
    top = table.loc[size.idxmax()]
    words = (
        f"The unexplained displacement of the string over time in {len(rows)} trials; at "
        f"most {format_mm(size.max(), 1)} in trial {top['trial']} at {format_ms(top['t'])}."
    )
    return svg_picture(figure, words)


def unexplained_chart(record: DiagnosisRecord, trial: str) -> Chart | None:
    """Chart the largest unexplained displacement along the string over time."""
    table = record.diagnosis.missing
    points = table[table["trial"] == trial]
    if points.empty:
        return None
    largest = np.hypot(points["x"], points["y"]).groupby(points["t"]).max() * MM_PER_M
    lines = [Line("largest along the string", largest.to_numpy(), "target")]
    words = f"Unexplained displacement in trial {trial}."
    return Chart("Unexplained", largest.index.to_numpy(), lines, "[mm]", words)


# --- the proposed motion
HYPOTHESIS_STYLES = (
    ("after", "-"),
    ("before", "--"),
    ("measured", "-."),
    ("target", ":"),
)


def proposal_picture(record: DiagnosisRecord) -> Picture | None:
    """Draw the strings that the hypotheses predict where they differ most, and how
    much.

    The distance is from the likeliest hypothesis, anywhere on the string, over time.
    """
    table = record.diagnosis.predicted
    if table.empty:
        return None
    groups = table.groupby("hypothesis", sort=False)
    hypotheses = {str(name): rows.reset_index(drop=True) for name, rows in groups}
    likeliest, *others = hypotheses
    expected = hypotheses[likeliest]
    distance = {}  # largest along the string [m], by time
    for name in others:
        x, y = (
            hypotheses[name]["x"] - expected["x"],
            hypotheses[name]["y"] - expected["y"],
        )
        distance[name] = np.hypot(x, y).groupby(expected["t"]).max()
    closest = min(others, key=lambda name: float(distance[name].max()))
    t = float(distance[closest].idxmax())

    figure = Figure(figsize=(7.2, 3.2))
    left, right = figure.subplots(1, 2)
    for (name, rows), (colour, dashes) in zip(
        hypotheses.items(), HYPOTHESIS_STYLES, strict=False
    ):
        string = rows[rows["t"] == t].sort_values("s")
        left.plot(
            string["x"] * MM_PER_M,
            string["y"] * MM_PER_M,
            dashes,
            marker=".",
            ms=4,
            color=colour,
            label=effect_title(name),
        )
        if name in distance:
            over_time = distance[name] * MM_PER_M
            right.plot(
                over_time.index * MM_PER_M,
                over_time,
                dashes,
                lw=1.2,
                color=colour,
            )
    left.set(xlabel="x [mm]", ylabel="y [mm]", title=f"at {format_ms(t)}")
    left.set(aspect="equal", adjustable="datalim")
    floor = float(record.diagnosis.residuals["sigma"].median() * MM_PER_M)
    right.axhspan(0, floor, color="grid", lw=0)
    right.annotate(
        "noise floor",
        (1, floor),
        fontsize=8,
        xycoords=("axes fraction", "data"),
        ha="right",
        va="bottom",
    )
    right.set(xlabel="time [ms]", ylabel="largest distance [mm]", ylim=(0, None))
    right.axvline(t * MM_PER_M, color="axis", lw=1)
    add_legend_above(figure, 4)
    largest = [
        f"{effect_title(name)} {format_mm(d.max(), 1)}" for name, d in distance.items()
    ]
    words = (
        f"The proposed motion at {format_ms(t)}; largest distances from "
        f"{effect_title(likeliest)}: {', '.join(largest)}."
    )
    return svg_picture(figure, words)
