"""The study's picture: what was read, refused and wrong under each condition, and how far off what was read is."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from stringcast.stages.report.theme import LIGHT, STYLE


def overview(shares: pd.DataFrame, path: Path) -> None:
    """Write a bar for each condition and severity. shares: table SHARES."""
    with plt.style.context(STYLE):
        figure, (left, right) = plt.subplots(1, 2, figsize=(10, 0.9 + 0.19 * len(shares)), sharey=True)
        rows = np.arange(len(shares))[::-1]
        refused = 1 - shares["read"]
        left.barh(rows, shares["read"] - shares["wrong"], color=LIGHT["measured"], label="read")
        left.barh(rows, refused, left=1 - refused, color=LIGHT["grid"], label="refused")
        left.barh(rows, shares["wrong"], left=shares["read"] - shares["wrong"], color=LIGHT["before"], label="wrong")
        left.set_yticks(rows, shares["condition"] + " " + shares["severity"].astype(str))
        left.set(xlabel="share of frames", xlim=(0, 1), ylim=(-0.7, len(shares) - 0.3))
        left.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
        for name, label, colour in (("line_px", "line", "after"), ("tip_px", "tip", "target")):
            right.plot(shares[name], rows, "o", ms=4, color=LIGHT[colour], label=f"{label}, median")
            right.plot(shares[f"{name}_95"], rows, "|", ms=8, color=LIGHT[colour], label=f"{label}, 95 %")
        right.axvline(3, color=LIGHT["wall"], ls="--", lw=1)
        right.set(xlabel="error of what was read / px; beyond the dashed line it is wrong", xscale="log")
        right.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4)
        figure.savefig(path, dpi=90, facecolor="white")
        plt.close(figure)
