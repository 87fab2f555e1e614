"""A diagnosis as people read it; jinja filters of the page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from stringcast.stages.report.words import UNKNOWN, significant, unit

HANDY = {"s": (1e3, "ms"), "m": (1e3, "mm"), "rad": (180 / np.pi, "°"), "1": (1.0, "")}
OUTCOMES = {"none": "nothing is wrong", "unknown": "something that the library does not hold"}


def plain(name: str) -> str:
    """An effect, or several joined by ' + ', in plain words."""
    return OUTCOMES.get(name, name.replace("_", " "))


def percent(share: float) -> str:
    """A probability or share; what is small or nearly certain in words."""
    if not np.isfinite(share):
        return UNKNOWN
    return "under 1 %" if share < 0.005 else "over 99 %" if 0.995 < share < 1 else f"{100 * share:.0f} %"


def gain(value: float) -> str:
    """A log-likelihood, its thousands apart."""
    return f"{value:,.0f}".replace(",", "\u202f").replace("-", "−") if np.isfinite(value) else UNKNOWN


def quantity(row: Mapping[str, Any]) -> Markup:
    """A value with its unit. row: of table CAUSES."""
    return _with_unit(_figures(row)[0], row["unit"])


def interval(row: Mapping[str, Any]) -> Markup:
    """The 95 % interval with its unit, or its lower end if that is what is known. row: of table CAUSES."""
    _, low, high = _figures(row)
    ends = f"at least {low}" if row.get("at_least") else f"{low} to {high}"
    return Markup(UNKNOWN) if UNKNOWN in (low, high) else _with_unit(ends, row["unit"])


def _figures(row: Mapping[str, Any]) -> list[str]:
    """Value, low and high in handy units, with as many figures as their interval is worth."""
    factor = HANDY.get(row["unit"], (1.0, ""))[0]
    values = [factor * row[name] for name in ("value", "low", "high")]
    width = values[2] - values[1]
    if not (np.isfinite(width) and 1e-4 < width < 1e4):
        return [significant(value).replace("-", "−") for value in values]
    decimals = max(0, 1 - int(np.floor(np.log10(width))))
    return [f"{value:.{decimals}f}".replace("-", "−") for value in values]


def _with_unit(figures: str, name: str) -> Markup:
    return Markup("{} {}").format(figures, unit(HANDY.get(name, (1.0, name))[1])).strip()


def headline(document: Mapping[str, Any]) -> str:
    """The verdict in a few words. document: diagnosis.json."""
    groups = document["indistinguishable"]
    alike = {name for group in groups for name in group}
    certain = [plain(cause["effect"]) for cause in document["causes"] if cause["effect"] not in alike]
    causes = joined([*certain, *(joined([plain(name) for name in group], "or") for group in groups)])
    return {
        "none": "The simulation agrees with what was measured",
        "effect": f"The cause: {causes}" if len(certain) == 1 else f"The causes: {causes}",
        "ambiguous": f"{causes.capitalize()}: this data cannot tell them apart",
        "unknown": "Something is missing, and it is not in the library",
        "insufficient": "This data cannot answer",
    }[document["verdict"]]


def joined(names: Sequence[str], word: str = "and") -> str:
    """a, b and c."""
    return f" {word} ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))
