"""How often it hit within one, two and all manipulations."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from stringcast.stages.report.paper.record import LABELS, Drawn, PaperRecord
from stringcast.stages.report.picture import LIGHT

SHOWN = {1: ("before", "o"), 2: ("after", "s"), 3: ("measured", "D"), 5: ("target", "^")}


def rates(record: PaperRecord) -> Drawn | None:
    """A row an experiment; bars are 95 % intervals."""
    if not record.conditions:
        return None
    figure = Figure(figsize=(5.4, 1.1 + 0.42 * len(record.conditions)))
    axes = figure.subplots()
    for row, condition in enumerate(record.conditions):
        table = record.of("rates", condition).set_index("within")
        for step, (within, (colour, marker)) in enumerate(SHOWN.items()):
            if within in table.index:
                one = table.loc[within]
                place = row + 0.18 * (step - 1.5)
                axes.hlines(place, one["low"], one["high"], color=LIGHT[colour], lw=2.5, alpha=0.3)
                label = f"within {within}" if row == 0 else None
                axes.plot(one["share"], place, marker, color=LIGHT[colour], ms=4.5, ls="none", label=label)
    labels = [f"{LABELS[name]}  (n = {record.of('rates', name)['count'].iloc[0]})" for name in record.conditions]
    axes.set_yticks(range(len(labels)), labels)
    axes.set(xlim=(-0.02, 1.02), ylim=(len(labels) - 0.5, -0.5), xlabel="share of runs that hit, with 95 % interval")
    axes.set_xticks(np.linspace(0, 1, 6), ["0", "20 %", "40 %", "60 %", "80 %", "100 %"])
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper left", ncols=4, title="manipulations")
    return Drawn(figure, _words(record))


def _words(record: PaperRecord) -> str:
    whole = record.tables["rates"]
    most = whole[whole["within"] == whole["within"].max()].set_index("condition")
    said = [f"{LABELS[name]} {most.loc[name, 'right']} of {most.loc[name, 'count']}" for name in record.conditions]
    return f"Runs that hit within {whole['within'].max()} manipulations: {', '.join(said)}."
