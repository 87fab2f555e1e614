"""Pictures of results, for scripts and notebooks."""

from __future__ import annotations

import io

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stringcast.data.schema import DataError
from stringcast.stages.common import MM_PER_M

# colours of Okabe and Ito, safe for colour blindness
MEASURED, BASE, EXTENDED = "#009e73", "#d55e00", "#0072b2"
MODELS = {"base": BASE, "extended": EXTENDED}


class ShownFigure(Figure):
    """A figure that a notebook shows; `savefig(file)` writes it."""

    def _repr_svg_(self) -> str:
        text = io.StringIO()
        self.savefig(text, format="svg")
        return text.getvalue()


def diagnosis_figure(residuals: pd.DataFrame, gain: pd.DataFrame) -> ShownFigure:
    """Draw the frame with the largest misfit of the base model, and all residuals.

    Parameters
    ----------
    residuals : DataFrame
        Table RESIDUALS of a diagnosis.
    gain : DataFrame
        Its table HELD_OUT.

    Raises
    ------
    DataError
        If there are no residuals.
    """
    if residuals.empty and gain.empty:
        raise DataError(
            "plot()",
            "there is nothing to draw, because too few trials could be used",
            "Look at print(trials).",
        )
    figure = ShownFigure(figsize=(9.0, 3.6), layout="constrained")
    place, bars = figure.subplots(1, 2, width_ratios=(1.0, 1.2))
    if len(residuals):
        draw_largest_misfit(place, residuals)
    else:
        place.set_axis_off()
    for model, colour in MODELS.items():
        rms = gain[f"rms_{model}"] * MM_PER_M
        bars.plot(rms, gain["trial"], "o", color=colour, label=f"{model} model")
    floor = gain["noise_floor"] * MM_PER_M
    options = {"markersize": 14, "color": "0.2", "label": "noise floor"}
    bars.plot(floor, gain["trial"], "|", **options)
    bars.set(xlim=(0, None), title="residual on each trial when left out, rms")
    bars.set_xlabel("residual [mm]")
    bars.legend()
    return figure


def draw_largest_misfit(axes: Axes, residuals: pd.DataFrame) -> None:
    """Draw measured and simulated string in the frame with the largest misfit."""
    off = np.hypot(
        residuals["x"] - residuals["base_x"], residuals["y"] - residuals["base_y"]
    )
    worst = residuals.loc[off.idxmax()]
    in_frame = (residuals["trial"] == worst["trial"]) & (residuals["t"] == worst["t"])
    frame = residuals[in_frame].sort_values("s")
    axes.plot(
        *(frame[["x", "y"]].T.to_numpy()), "o", ms=4, color=MEASURED, label="measured"
    )
    for model, colour in MODELS.items():
        line = frame[[f"{model}_x", f"{model}_y"]].T.to_numpy()
        axes.plot(*line, color=colour, label=f"{model} model")
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", adjustable="datalim")
    axes.set_title(f"{worst['trial']} at {worst['t']:.3f} s, where they differ most")
    axes.legend(fontsize=8)


def parameter_figure(parameters: pd.DataFrame) -> ShownFigure:
    """Draw each parameter with its 95 % interval, within the range of its search.

    Parameters
    ----------
    parameters : DataFrame
        Table PARAMETERS of an estimate.
    """
    height = 1.2 + 0.32 * len(parameters)
    figure = ShownFigure(figsize=(7.0, height), layout="constrained")
    axes = figure.subplots()
    for row, parameter in enumerate(parameters.itertuples()):
        low, high = parameter.minimum, parameter.maximum
        ends = np.array([parameter.low, parameter.value, parameter.high], float)
        shares = np.clip((ends - low) / (high - low), 0, 1)
        if low > 0:  # positive ranges span powers of ten
            ends = np.clip(ends, low, high)
            shares = np.log(ends / low) / np.log(high / low)
        colour = EXTENDED if parameter.determined else "0.6"
        axes.plot(shares[[0, 2]], [row, row], color=colour, lw=5, alpha=0.4)
        axes.plot(shares[1], row, "o", color=colour)
        text = f" {parameter.value:.3g} {parameter.unit}"
        axes.text(1.02, row, text, va="center", fontsize=8)
    axes.set_yticks(range(len(parameters)), parameters["name"])
    axes.invert_yaxis()
    axes.set(xlim=(0, 1), xticks=(0, 1), title="parameters with 95 % intervals")
    axes.set_xticklabels(["least allowed", "largest allowed"])
    axes.set_xlabel("grey: the data do not determine it")
    return figure
