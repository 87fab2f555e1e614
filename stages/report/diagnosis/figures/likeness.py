"""Which effects look alike in this data."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from stringcast.stages.report.diagnosis.record import DiagnosisRecord
from stringcast.stages.report.diagnosis.words import plain
from stringcast.stages.report.picture import LIGHT, Picture, vector


def likeness(record: DiagnosisRecord) -> Picture | None:
    """A cell for each two effects, the fuller the more alike they are."""
    table = record.diagnosis.likeness
    if table.empty:
        return None
    names = list(dict.fromkeys([*table["other"], *table["effect"]]))
    place = {name: number for number, name in enumerate(names)}
    figure = Figure(figsize=(5.4, 1.6 + 0.34 * len(names)))
    axes = figure.subplots()
    for row in table.itertuples():
        across, down = sorted((place[row.effect], place[row.other]))
        colour = {"facecolor": LIGHT["after"], "alpha": 0.75 * row.cosine**2}
        axes.add_patch(Rectangle((across - 0.48, down - 0.46), 0.96, 0.92, lw=0, **colour))
        axes.text(across, down, f"{row.cosine:.2f}", ha="center", va="center", fontsize=8)
    words = [plain(name) for name in names]
    axes.set(xlim=(-0.5, len(names) - 1.5), ylim=(len(names) - 0.5, 0.5))
    axes.set_xticks(np.arange(len(names) - 1), words[:-1], rotation=40, ha="right", rotation_mode="anchor")
    axes.set_yticks(np.arange(1, len(names)), words[1:])
    axes.grid(visible=False)
    most = table.loc[table["cosine"].idxmax()]
    pair = f"{plain(most['effect'])} and {plain(most['other'])}, {most['cosine']:.2f}"
    return vector(figure, f"How alike {len(names)} effects are in this data; most of all {pair}.")
