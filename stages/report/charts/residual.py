"""How far simulated strings are from the measured one."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import AsinhNorm, LinearSegmentedColormap
from matplotlib.figure import Figure

from stringcast.stages.report.charts.time import mark_movement, moving
from stringcast.stages.report.formatting import gain, mm
from stringcast.stages.report.page import Chart, Line
from stringcast.stages.report.records import Cast, DiagnosisRecord, RunRecord, away, rms
from stringcast.stages.report.theme import (
    LIGHT_COLOURS,
    MM_PER_M,
    Picture,
    framed,
    vector,
)

# --- the same colours for the same things
MODEL = {"base": LIGHT_COLOURS["before"], "extended": LIGHT_COLOURS["after"]}
NAMES = {"base": "base model", "extended": "extended model"}
# Zero is the page itself, light or dark; both ends stand out on either.
BELOW, ABOVE = (0.10, 0.50, 0.80), (0.93, 0.45, 0.08)
DIVERGING = LinearSegmentedColormap.from_list(
    "diverging",
    [(0, (*BELOW, 1)), (0.5, (*BELOW, 0)), (0.5, (*ABOVE, 0)), (1, (*ABOVE, 1))],
)
NOTHING = (0.55, 0.58, 0.62, 0.35)  # where nothing was measured


# --- a cast
# as many as are told apart; a picture of more is twice as large
STEPS = colormaps["viridis"].resampled(24)
# along the string, and at most in time: a column is two pixels of the page
CELLS, COLUMNS = 30, 140


def furthest(record: RunRecord) -> float:
    """End of the colour scale of all casts [m]: beyond it lie the farthest 0.5 % of
    points after estimation.
    """
    away = [
        residuals(record, cast, cast.after)["away"]
        for cast in record.casts
        if cast.measured
    ]
    return float(pd.concat(away).quantile(0.995)) if away else 0.0


def residual_map(record: RunRecord, cast: Cast, furthest: float) -> Picture | None:
    """The residual after estimation over arc length and time: mean distances in cells
    of the string and of a frame, or several; frames not read stay empty. furthest: end
    of the colour scale [m].
    """
    if not cast.measured:
        return None
    table = residuals(record, cast, cast.after)
    half = np.median(np.diff(cast.t)) / 2 if len(cast.t) > 1 else cast.motion.duration
    moments = np.append(cast.t - half, cast.t[-1] + half)
    if len(cast.t) > COLUMNS:
        moments = np.linspace(moments[0], moments[-1], COLUMNS + 1)
    edges = np.linspace(0, max(record.model.string.length, table["s"].max()), CELLS + 1)
    places = (table["s"], cast.t[table["frame"]])
    total, count = (
        np.histogram2d(*places, (edges, moments), weights=w)[0]
        for w in (table["away"], None)
    )
    with np.errstate(invalid="ignore"):
        cells = total / count

    figure = framed(5.4, 2.6)
    axes = figure.subplots()
    drawn = axes.pcolorfast(
        moments * MM_PER_M,
        edges * MM_PER_M,
        cells * MM_PER_M,
        cmap=STEPS,
        vmin=0,
        vmax=furthest * MM_PER_M,
    )
    axes.grid(visible=False)
    axes.set_ylabel("arc length [mm]")
    bar = figure.colorbar(drawn, ax=axes, aspect=20, label="distance [mm]", pad=0.02)
    assert bar.solids is not None
    bar.solids.set_rasterized(True)  # each step would be a path
    mark_movement(axes, cast)
    axes.set_xlabel("time [ms]")
    whole = mm(float(np.sqrt(np.mean(table["away"] ** 2))), 1)
    return vector(
        figure,
        f"Distance of the simulated from the measured string after estimation: RMS {whole}.",
    )


def residual_curves(record: RunRecord, cast: Cast) -> Chart | None:
    """Root mean square distance over the whole string, frame by frame, before and after
    estimation [mm].
    """
    if not cast.measured:
        return None
    lines, whole = [], []
    for name, simulated in (("before", cast.before), ("after", cast.after)):
        table = residuals(record, cast, simulated)
        squares = (
            (table["away"] ** 2)
            .groupby(table["frame"])
            .mean()
            .reindex(range(len(cast.t)))
        )
        lines.append(
            Line(f"{name} estimation", np.sqrt(squares.to_numpy()) * MM_PER_M, name)
        )
        whole.append(mm(float(np.sqrt(np.mean(table["away"] ** 2))), 1))
    words = f"Distance of the simulated from the measured string: RMS {whole[0]} before, {whole[1]} after."
    caption = "Root mean square over the whole string. Gaps are frames that could not be read."
    return Chart(
        "Distance over time",
        cast.t,
        lines,
        "RMS [mm]",
        words,
        caption,
        moving(cast),
        cast.verdict.t,
    )


def residuals(record: RunRecord, cast: Cast, simulated: np.ndarray) -> pd.DataFrame:
    """Table of frame, s [m] and away [m]: each measured point's distance from the
    simulated string (F, n, 2) at the same arc length.
    """
    frame = np.repeat(
        list(cast.measured), [len(line) for line in cast.measured.values()]
    )
    x, y, s = np.concatenate(list(cast.measured.values())).T
    place = np.clip(
        s / record.model.string.segment_length, 0, record.model.string.points - 1
    )
    first = np.minimum(place.astype(int), record.model.string.points - 2)
    share = (place - first)[:, None]
    there = (1 - share) * simulated[frame, first] + share * simulated[frame, first + 1]
    return pd.DataFrame(
        {
            "frame": frame,
            "s": s,
            "away": np.hypot(*(there - np.stack([x, y], axis=-1)).T),
        }
    )


# --- a diagnosis
PLACES, MOMENTS = 30, 80  # cells at most, along the string and in time
LEAST = 5.0  # standard deviations: the end of the colour scale is never nearer
PARTS = {"normal": "across the string", "tangential": "along the string"}


def maps(record: DiagnosisRecord, model: str) -> Picture | None:
    """A row for each trial: the normal and the tangential part of the residual, over
    the noise floor.
    """
    if not record.trials:
        return None
    rows = len(record.trials)
    figure = framed(5.4, 1.3 + 1.05 * rows, top=0.45, bottom=1.0, between=0.3)
    panels = figure.subplots(rows, 2, sharex=True, sharey=True, squeeze=False)
    sizes = [
        np.abs(part)
        for table in record.trials.values()
        for part in parts(table, "base").values()
    ]
    end = max(
        LEAST, float(np.quantile(np.concatenate(sizes), 0.99))
    )  # of the scale: the same for all trials and models
    scale = AsinhNorm(2.0, -end, end)
    for line, (trial, table) in zip(panels, record.trials.items(), strict=True):
        split = parts(table, model)
        drawn = [
            _map(axes, table, split[part], scale)
            for axes, part in zip(line, PARTS, strict=True)
        ]
        line[0].set_ylabel("s [mm]")
        # above the row, for names may be longer than it is high
        line[0].text(0.0, 1.05, trial, fontsize=8, transform=line[0].transAxes)
    for axes, words in zip(panels[0], PARTS.values(), strict=True):
        axes.set_title(words, fontsize=9, pad=16)
    for axes in panels[-1]:
        axes.set_xlabel("time [ms]")
    _bar(figure, drawn[0], end)
    return vector(
        figure,
        f"Residuals of the {NAMES[model]} over arc length and time in {rows} trials.",
    )


def _bar(figure: Figure, drawn: ScalarMappable, end: float) -> None:
    """The key of colours, below all panels."""
    place = (0.15, 0.46 / figure.get_figheight(), 0.8, 0.09 / figure.get_figheight())
    bar = figure.colorbar(
        drawn, cax=figure.add_axes(place), orientation="horizontal", extend="both"
    )
    above = [tick for tick in (1, 3, 10, 30, 100, 300, 1000) if tick <= end]
    ticks = [*(-tick for tick in reversed(above)), 0, *above]
    bar.set_ticks(ticks, labels=[str(tick).replace("-", "−") for tick in ticks])
    bar.minorticks_off()
    bar.set_label("measured less simulated [noise floor]")


def parts(table: pd.DataFrame, model: str) -> dict[str, np.ndarray]:
    """Normal and tangential part of the residual over the noise floor, (n,) each, in
    the base string's directions.

    As complex numbers a residual is its two parts times the direction of the string.
    """
    base = (table["x"] - table["base_x"]) + 1j * (table["y"] - table["base_y"])
    split = table["base_tangential"] + 1j * table["base_normal"]
    direction = np.divide(
        base, split, out=np.ones(len(table), complex), where=np.abs(split) > 0
    )
    off = (table["x"] - table[f"{model}_x"]) + 1j * (table["y"] - table[f"{model}_y"])
    along = (off / direction / table["sigma"]).to_numpy()
    return {"normal": along.imag, "tangential": along.real}


def _map(
    axes: Axes, table: pd.DataFrame, values: np.ndarray, scale: AsinhNorm
) -> ScalarMappable:
    """Means in cells of arc length and time."""
    # cells around the places measured, or even ones where there are many [m]
    s = table["s"].to_numpy()
    places = np.unique(np.round(s, 4))
    middle = (places[1:] + places[:-1]) / 2
    half = middle[0] - places[0] if len(middle) else max(places[0] / 4, 1e-3)
    last = places[-1] - middle[-1] if len(middle) else half
    along = np.concatenate([[max(places[0] - half, 0)], middle, [places[-1] + last]])
    if len(places) > PLACES:
        along = np.linspace(0, s.max() * (1 + 1e-9), PLACES + 1)

    times = np.unique(table["t"].to_numpy())
    frame = float(np.median(np.diff(times))) if len(times) > 1 else 0.01
    # [s] of even cells: gaps between frames stay empty
    width = max(frame, float(np.ptp(times)) / MOMENTS)
    moments = np.arange(times[0] - width / 2, times[-1] + width, width)
    total, count = (
        np.histogram2d(s, table["t"], (along, moments), weights=w)[0]
        for w in (values, None)
    )
    cells = np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)
    axes.grid(visible=False)
    colours = DIVERGING.with_extremes(bad=NOTHING)
    return axes.pcolorfast(
        moments * MM_PER_M, along * MM_PER_M, cells, cmap=colours, norm=scale
    )


def curves(record: DiagnosisRecord, trial: str) -> Chart:
    """Residual of a trial over time: over the whole string, and what noise alone and
    noise and simulation leave.
    """
    frames = record.trials[trial].groupby("t")
    t = np.array([at for at, _ in frames])
    lines = [
        Line(
            NAMES[model],
            np.array([np.sqrt(np.mean(away(frame, model) ** 2)) for _, frame in frames])
            * MM_PER_M,
            colour,
        )
        for model, colour in zip(record.models, ("before", "after"), strict=False)
    ]
    floor = (
        np.sqrt(2)
        * np.sqrt(frames["sigma"].apply(lambda some: np.mean(some**2))).to_numpy()
    )
    lines.append(Line("noise floor", floor * MM_PER_M, "soft", dashed=True))
    most = ", ".join(
        f"{mm(float(np.nanmax(line.values)) / MM_PER_M, 1)} for the {line.label}"
        for line in lines[:-1]
    )
    return Chart(
        "Residual",
        t,
        lines,
        "RMS [mm]",
        f"Residual in trial {trial} over time: at most {most}.",
    )


def tip_curves(record: DiagnosisRecord, trial: str, ends: pd.DataFrame) -> Chart:
    """Residuals of the models at the tip, or the outermost point measured, over time.
    ends: see `charts.string.last`.
    """
    lines = [
        Line(NAMES[model], away(ends, model) * MM_PER_M, colour)
        for model, colour in zip(record.models, ("before", "after"), strict=False)
    ]
    most = ", ".join(
        f"{model} {mm(float(away(ends, model).max()), 1)}" for model in record.models
    )
    words = f"The tip in trial {trial} over time: at most {most} off."
    return Chart("Tip", ends["t"].to_numpy(), lines, "off [mm]", words)


def size(record: DiagnosisRecord) -> Picture | None:
    """Root mean square of the residual in each trial, with what noise alone and noise
    and simulation leave.
    """
    table = record.diagnosis.residuals
    if table.empty:
        return None
    names = list(rms(table, "base").index)
    place = np.arange(len(names))
    figure = Figure(figsize=(5.4, 1.2 + 0.3 * len(names)))
    axes = figure.subplots()
    expected = {
        c: np.sqrt(2 * (table[c] ** 2).groupby(table["trial"]).mean()) * MM_PER_M
        for c in ("sigma", "doubt")
    }
    axes.barh(
        place,
        expected["doubt"],
        height=0.7,
        color=LIGHT_COLOURS["grid"],
        label="noise and the simulation's own error",
    )
    axes.plot(
        expected["sigma"],
        place,
        "|",
        ms=14,
        mew=1.6,
        color=LIGHT_COLOURS["ink"],
        label="noise floor",
    )
    for model in record.models:
        axes.plot(
            rms(table, model) * MM_PER_M,
            place,
            "o",
            ms=6,
            color=MODEL[model],
            label=NAMES[model],
        )
    axes.set(
        xlabel="residual, RMS [mm]", xlim=(0, None), yticks=place, yticklabels=names
    )
    axes.invert_yaxis()
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper left", ncols=2)
    whole = " and ".join(
        f"{mm(float(rms(table, m).max()), 1)} for the {NAMES[m]}" for m in record.models
    )
    return vector(
        figure, f"Residual in each trial against the noise floor: at most {whole}."
    )


# --- on trials left out of the fit
def predicted(record: DiagnosisRecord) -> Picture | None:
    """Residual over the whole string and at its tip, trial by trial."""
    table = record.diagnosis.held_out
    if table.empty:
        return None
    figure = Figure(figsize=(5.4, 1.2 + 0.3 * len(table)))
    panels = figure.subplots(1, 2, sharey=True)
    for axes, column, words in zip(
        panels, ("rms", "tip_rms"), ("whole string", "tip"), strict=True
    ):
        _pairs(axes, record, column)
        axes.set(title=words, xlabel="RMS [mm]", xlim=(0, None))
    if (
        len(record.models) > 1
        and "rms_known" in table
        and set(table["trial"]) <= set(record.document["trials"]["used"])
    ):
        known = table["rms_known"] * MM_PER_M
        panels[0].plot(
            known,
            range(len(table)),
            "o",
            ms=10,
            mfc="none",
            color=MODEL["extended"],
            label="fitted to all",
        )
    panels[0].set_yticks(range(len(table)), table["trial"])
    panels[0].invert_yaxis()
    figure.legend(
        *panels[0].get_legend_handles_labels(), loc="outside upper left", ncols=4
    )
    mean = ", ".join(
        f"{mm(float(np.sqrt((table[f'rms_{m}'] ** 2).mean())), 1)} for the {NAMES[m]}"
        for m in record.models
    )
    return vector(figure, f"Residual on trials left out of the fit: {mean}.")


def _pairs(axes: Axes, record: DiagnosisRecord, column: str) -> None:
    table = record.diagnosis.held_out
    place = np.arange(len(table))
    ends = np.stack([table[f"{column}_{model}"] * MM_PER_M for model in record.models])
    axes.hlines(
        place, ends.min(axis=0), ends.max(axis=0), color=LIGHT_COLOURS["axis"], lw=1.2
    )
    axes.plot(
        table["noise_floor"] * MM_PER_M,
        place,
        "|",
        ms=14,
        mew=1.6,
        color=LIGHT_COLOURS["ink"],
        label="noise floor",
    )
    for model, values in zip(record.models, ends, strict=True):
        axes.plot(values, place, "o", ms=6, color=MODEL[model], label=NAMES[model])


def likelier(record: DiagnosisRecord) -> Picture | None:
    """Gain of the log-likelihood trial by trial, and its mean with the standard error."""
    table = record.diagnosis.held_out
    if table.empty or len(record.models) == 1:
        return None
    figure = Figure(figsize=(5.4, 1.2 + 0.3 * len(table)))
    axes = figure.subplots()
    difference = table["log_likelihood_difference"]
    bars = axes.barh(
        table["trial"], difference, height=0.6, color=LIGHT_COLOURS["after"], alpha=0.6
    )
    axes.bar_label(
        bars,
        [gain(value) for value in difference],
        padding=4,
        fontsize=8,
        color=LIGHT_COLOURS["soft"],
    )
    mean, error = difference.mean(), difference.sem()
    axes.axvline(mean, color=LIGHT_COLOURS["ink"], lw=1.4, label="mean")
    if np.isfinite(error):
        axes.axvspan(
            mean - error,
            mean + error,
            color=LIGHT_COLOURS["axis"],
            alpha=0.3,
            lw=0,
            label="its standard error",
        )
    axes.axvline(0, color=LIGHT_COLOURS["axis"], lw=1)
    axes.set(xlabel="log-likelihood, extended less base")
    axes.margins(x=0.15)
    axes.invert_yaxis()
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper left", ncols=2)
    return vector(
        figure,
        f"Gain of the log-likelihood on each trial left out; on average {gain(mean)}.",
    )
