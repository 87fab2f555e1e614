"""Numbers, symbols and stretches of time as people read them; jinja filters of the page."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup, escape

from stringcast.stages.report.picture import superscript

UNKNOWN = "not known"


def mm(metres: float | None, digits: int = 0) -> str:
    """A length in millimetres."""
    return f"{metres * 1e3:.{digits}f} mm" if metres is not None and np.isfinite(metres) else UNKNOWN


def ms(seconds: float, digits: int = 0) -> str:
    """A time in milliseconds."""
    return f"{seconds * 1e3:.{digits}f} ms" if np.isfinite(seconds) else UNKNOWN


def rate(share: float | None) -> str:
    """A matching rate."""
    return f"{share:.3f}" if share is not None and np.isfinite(share) else UNKNOWN


def significant(value: float) -> str:
    """Three significant figures, with a power of ten where that is shorter."""
    if not np.isfinite(value):
        return UNKNOWN
    if value == 0 or 1e-3 <= abs(value) < 1e4:
        return f"{value:.3g}" if abs(value) < 1000 else f"{float(f'{value:.3g}'):.0f}"
    figures, power = f"{value:.2e}".split("e")
    return f"{float(figures):g} × 10{superscript(power)}"


def symbol(name: str) -> Markup:
    """k_ph with its index set low."""
    stem, _, index = name.partition("_")
    return Markup("<i>{}</i><sub>{}</sub>").format(stem, index) if index else Markup("<i>{}</i>").format(stem)


def sentence(text: str) -> Markup:
    """A sentence with the symbols in it set as symbols."""
    return Markup(re.sub(r"\b[kcC]_\w+\b", lambda found: str(symbol(found[0])), str(escape(text))))


def unit(text: str) -> Markup:
    """N s2/(m2 kg) with its powers set high."""
    return Markup(re.sub(r"(?<=[a-z])(\d)", r"<sup>\1</sup>", str(escape(text))))


def unread(readings: pd.DataFrame) -> list[dict[str, Any]]:
    """Frames that could not be read: how many for each reason, and when."""
    bad = readings[~readings["valid"].astype(bool)]
    return [
        {"reason": reason, "count": len(rows), "when": ", ".join(_spans(rows["frame"], rows["t"]))}
        for reason, rows in bad.groupby("reason", sort=False)
    ]


def _spans(frames: pd.Series, times: pd.Series) -> Iterator[str]:
    """Stretches of consecutive frames, by their times [ms]."""
    numbers, t = frames.to_numpy(), times.to_numpy()
    ends = [0, *(np.flatnonzero(np.diff(numbers) != 1) + 1), len(numbers)]
    for first, end in pairwise(ends):
        yield f"{t[first] * 1e3:.0f}" if end - first == 1 else f"{t[first] * 1e3:.0f} to {t[end - 1] * 1e3:.0f}"


def settings(block: Mapping[str, Any], place: str = "") -> Iterator[tuple[str, str]]:
    """Every setting by the name it has on the command line, in the order in which a run keeps them."""
    for name, value in sorted(block.items()):
        if isinstance(value, Mapping) and value:
            yield from settings(value, f"{place}{name}.")
        else:
            yield f"{place}{name}", "null" if value is None else str(value)
