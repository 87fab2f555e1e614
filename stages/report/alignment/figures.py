"""Pictures of an alignment."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from stringcast.stages.report.picture import LIGHT, MM, Picture, vector

WORST = 25.0  # rise of the deviance up to which it is drawn
END = 3.84  # of a 95 % interval
SHARES = ("before", "after")


def places(seen: pd.DataFrame) -> Picture:
    """The outermost piece that was sighted, frame by frame: where it was seen, and told before and after."""
    outer = seen[seen["link"] == seen["link"].max()].sort_values("share").groupby(["trial", "t"]).tail(2)
    figure = Figure(figsize=(4.4, 4.0))
    axes = figure.subplots()
    for way in SHARES:
        x, y = (outer[c] + outer[way] * outer[f"along_{c}"] for c in "xy")
        axes.plot(x * MM, y * MM, ".", ms=2.5, color=LIGHT[way], label=f"told, {way}")
    axes.plot(outer["x"] * MM, outer["y"] * MM, ".", ms=1.2, color=LIGHT["measured"], label="seen")
    axes.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal", adjustable="datalim")
    axes.legend(loc="best", markerscale=3)
    rms = [float(np.sqrt(np.mean(outer[way] ** 2))) * MM for way in SHARES]
    return vector(figure, f"The hand as seen and as told: {rms[0]:.2f} mm apart before, {rms[1]:.2f} mm after.")


def residuals(seen: pd.DataFrame) -> Picture:
    """Told less seen over time, all trials on one clock."""
    figure = Figure(figsize=(7.2, 3.4))
    panels = figure.subplots(2, 1, sharex=True)
    for axes, way in zip(panels, SHARES, strict=True):
        axes.plot(seen["t"], seen[way] * MM, ".", ms=1.2, color=LIGHT[way], alpha=0.5, rasterized=True)
        axes.axhline(0.0, lw=0.6, color=LIGHT["axis"])
        axes.set_ylabel(f"{way} [mm]")
    most = float(np.quantile(np.abs(seen["after"]), 0.995)) * MM
    panels[1].set(xlabel="time by the camera's clock [s]", ylim=(-1.5 * most, 1.5 * most))
    return vector(figure, "Told less seen over time, as if camera and arm were aligned, and aligned.")


def likelihood(table: pd.DataFrame) -> Picture:
    """How much worse the fit is with another offset, with and without a lag of the arm."""
    figure = Figure(figsize=(4.4, 3.2))
    axes = figure.subplots()
    for name, words, colour in (("alone", "no lag", "before"), ("with_lag", "the arm may lag", "after")):
        drawn = table[table[name] < 2 * WORST]
        axes.plot(drawn["offset"] * MM, drawn[name], ".-", color=LIGHT[colour], label=words)
    axes.axhline(END, ls="--", lw=0.8, color=LIGHT["axis"], label="95 %")
    axes.set(xlabel="arm's clock less the camera's [ms]", ylabel="rise of the deviance", ylim=(0, WORST))
    axes.legend(loc="best")
    inside = table[table["with_lag"] <= END]["offset"] * MM
    said = f"With a lag allowed, offsets from {inside.min():.2f} to {inside.max():.2f} ms fit about as well."
    return vector(figure, said)
