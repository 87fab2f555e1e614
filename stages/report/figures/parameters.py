"""Each parameter over the manipulations, within the range that was searched."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.ticker import NullLocator

from stringcast.data.artifacts import Estimate
from stringcast.stages.model.parameter import Parameter
from stringcast.stages.report.picture import LIGHT, Picture, framed, powers, vector
from stringcast.stages.report.words import significant


def history(parameter: Parameter, estimates: Sequence[Estimate]) -> Picture:
    """From the start value (0) on. Bars: 95 % intervals. Hollow: this data does not determine it."""
    tables = [estimate.parameters.set_index("name") for estimate in estimates]
    rows = pd.DataFrame([table.loc[parameter.name] for table in tables]).reset_index(drop=True)
    figure = framed(2.5, 1.55, left=0.5, top=0.16)
    axes = figure.subplots()
    lowest, highest = rows["minimum"].min(), rows["maximum"].max()
    axes.axhspan(lowest, highest, color=LIGHT["axis"], alpha=0.16, lw=0)
    axes.plot(np.arange(len(rows) + 1), [parameter.start, *rows["value"]], color=LIGHT["after"], lw=1.2)
    axes.vlines(rows.index + 1, rows["low"], rows["high"], color=LIGHT["after"], lw=4, alpha=0.35)
    for number, row in rows.iterrows():
        fill = LIGHT["after"] if row["determined"] else "none"
        axes.plot(int(number) + 1, row["value"], "o", ms=5, mec=LIGHT["after"], mfc=fill)
    if lowest > 0:
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter(powers())
        axes.yaxis.set_minor_locator(NullLocator())
    else:
        axes.ticklabel_format(axis="y", scilimits=(-2, 4))
    axes.set_xticks(range(len(rows) + 1))
    axes.set_xlim(-0.3, len(rows) + 0.3)
    axes.set_xlabel("estimation", fontsize=8)
    last = rows.iloc[-1]
    known = "" if last["determined"] else ", not determined by this data"
    return vector(
        figure,
        f"{parameter.name.replace('_', ' ')} from {significant(parameter.start)} at the start to "
        f"{significant(last['value'])} {parameter.unit} after {len(rows)} estimation(s){known}.",
    )
