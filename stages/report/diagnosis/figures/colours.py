"""The same colours for the same things in all figures of a diagnosis."""

from __future__ import annotations

from matplotlib.colors import LinearSegmentedColormap

from stringcast.stages.report.picture import LIGHT

MODEL = {"base": LIGHT["before"], "extended": LIGHT["after"]}
NAMES = {"base": "base model", "extended": "extended model"}
# Zero is the page itself, light or dark; both ends stand out on either.
BELOW, ABOVE = (0.10, 0.50, 0.80), (0.93, 0.45, 0.08)
DIVERGING = LinearSegmentedColormap.from_list(
    "diverging", [(0, (*BELOW, 1)), (0.5, (*BELOW, 0)), (0.5, (*ABOVE, 0)), (1, (*ABOVE, 1))]
)
NOTHING = (0.55, 0.58, 0.62, 0.35)  # where nothing was measured
