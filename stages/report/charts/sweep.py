"""Charts of a sweep: outcomes over settings and over the workspace."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from stringcast.stages.common import MM_PER_M
from stringcast.stages.report.charts.axes import label_decades, new_axes
from stringcast.stages.report.formatting import format_mean, format_value
from stringcast.stages.report.outcomes import Outcome, mean_response
from stringcast.stages.report.theme import Picture, svg_picture

MIN_LOG_AXIS_RATIO = 20  # of a setting's largest to its smallest level
EQUAL_VALUES_TOLERANCE = 1e-9  # relative; geometric means have errors of 1e-15
MAX_LABEL_LENGTH = 28  # characters of an axis label in the usual size
MIN_OPACITY = 0.15
TARGET_COLUMNS = ["target.x", "target.y"]


def setting_label(factor: str, units: Mapping[str, str]) -> str:
    """Return the axis label of a setting."""
    return f"{factor} [{units[factor]}]" if factor in units else factor


def outcome_curve(
    jobs: pd.DataFrame, outcome: Outcome, factor: str, units: Mapping[str, str]
) -> Picture | None:
    """Draw an outcome of finished jobs over a setting; None if no job has it.

    factor: column of the setting. units: units of settings, by column.
    """
    means = mean_response(jobs, outcome, [factor])
    if means.empty:
        return None
    figure, axes = new_axes(2.9, 2.2)
    known = jobs[jobs[outcome.name].notna()].sort_values(factor, kind="stable")
    if pd.api.types.is_numeric_dtype(known[factor]):
        dashes = "-"
        _tick_levels(axes, np.sort(known[factor].unique()))
    else:
        dashes = "none"
        axes.tick_params(axis="x", labelrotation=20)
    values = known[outcome.name] * outcome.scale
    axes.plot(known[factor], values, "o", ms=3, mew=0, color="wall", alpha=0.5)
    x, low, high = means[factor], means["low"], means["high"]
    axes.plot(x, means["mean"], "o", ls=dashes, ms=4.5, color="after")
    axes.vlines(x, low, high, color="after", lw=4, alpha=0.35)
    if outcome.axis == "log":
        _use_log_scale(axes)
    axes.set_xlabel(setting_label(factor, units), fontsize=8)
    is_long = len(outcome.title) > MAX_LABEL_LENGTH
    axes.set_ylabel(outcome.title, fontsize=7 if is_long else 8)
    texts = [f"{format_mean(row)} at {row[factor]}" for row in means.to_dict("records")]
    words = f"{outcome.title} over {factor}: {', '.join(texts)}."
    return svg_picture(figure, words)


def _tick_levels(axes: Axes, levels: np.ndarray) -> None:
    """Put a tick at each ascending level of a setting, on a linear or log scale."""
    if 0 < levels[0] * MIN_LOG_AXIS_RATIO < levels[-1]:
        axes.set_xscale("log")
    axes.set_xticks(levels, [f"{level:g}" for level in levels])
    axes.xaxis.set_minor_locator(NullLocator())


def _use_log_scale(axes: Axes) -> None:
    low, high = axes.dataLim.intervaly
    if high < low * (1 + EQUAL_VALUES_TOLERANCE):
        axes.set_ylim(low / 2, high * 2)
    axes.set_yscale("log")
    label_decades(axes.yaxis)
    if high < 10 * low:  # powers of ten would give one label or none
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter(
            FuncFormatter(lambda value, _: format_value(value))
        )


def target_map(jobs: pd.DataFrame, max_casts: int) -> Picture:
    """Draw a mark at each target, darker for fewer casts until a hit (median seed).

    Hollow marks: the median seed did not hit. Crosses: no job finished, mostly because
    the target is out of reach. jobs: those that ended, with columns target.x and
    target.y [m], state, hit and casts.
    """
    needed = jobs["casts"].where(jobs["hit"] == 1, np.inf)
    needed = needed.where(jobs["state"] == "done", np.nan)
    median = needed.groupby([jobs[name] for name in TARGET_COLUMNS]).agg(_lower_median)
    figure, axes = new_axes(4.4, 4.2)
    for place, casts in median.items():
        x, y = np.array(place) * MM_PER_M
        if np.isnan(casts):
            axes.plot(x, y, "x", color="wall", ms=7)
        elif np.isinf(casts):
            axes.plot(x, y, "s", mfc="none", mec="before", ms=17)
        else:
            shade = 1 - (1 - MIN_OPACITY) * (casts - 1) / max(max_casts - 1, 1)
            axes.plot(x, y, "s", color="after", alpha=shade, mew=0, ms=18)
            number = f"{casts:.0f}"
            axes.text(x, y, number, color="ink", ha="center", va="center", fontsize=8)
    axes.set(xlabel="x of the target [mm]", ylabel="y of the target [mm]")
    axes.set(aspect="equal", adjustable="datalim")
    axes.margins(0.12)
    words = (
        f"Of {len(median)} targets {np.isfinite(median).sum()} were hit, "
        f"{(median == 1).sum()} in the first cast; {np.isinf(median).sum()} were not, "
        f"{median.isna().sum()} did not run."
    )
    return svg_picture(figure, words)


def _lower_median(needed: pd.Series) -> float:
    """Return the lower median; NaN without a finished job."""
    known = np.sort(needed.dropna().to_numpy(float))
    return float(known[(len(known) - 1) // 2]) if len(known) else np.nan
