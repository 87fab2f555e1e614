"""The levels of a setting on an axis."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import NullLocator

WIDE = 20  # a setting whose levels span more than this ratio has an axis in powers of ten
Place = Callable[[pd.Series], np.ndarray]


def named(values: pd.Series) -> dict[Any, str]:
    """The levels in order, and how they are written."""
    return {level: f"{level:g}" if pd.api.types.is_number(level) else str(level) for level in sorted(values.unique())}


def marked(axes: Axes, values: pd.Series) -> Place:
    """Mark the levels on the x axis, numbers at their place and words side by side. Returns where each value is."""
    levels = named(values)
    if not pd.api.types.is_numeric_dtype(values):
        axes.set_xticks(range(len(levels)), list(levels.values()), rotation=20, ha="right", rotation_mode="anchor")
        axes.set_xlim(-0.5, len(levels) - 0.5)
        return lambda some: some.map(list(levels).index).to_numpy(float)
    if min(levels) > 0 and max(levels) / min(levels) > WIDE:
        axes.set_xscale("log")
    axes.set_xticks(list(levels), list(levels.values()))
    axes.xaxis.set_minor_locator(NullLocator())
    return lambda some: some.to_numpy(float)
