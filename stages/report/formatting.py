"""Numbers, symbols, stretches of time and verdicts as people read them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup, escape

from stringcast.stages.report.theme import superscript

UNKNOWN = "not known"
HANDY = {"s": (1e3, "ms"), "m": (1e3, "mm"), "rad": (180 / np.pi, "°"), "1": (1.0, "")}
OUTCOMES = {
    "none": "nothing is wrong",
    "unknown": "something that the library does not hold",
}


def mm(metres: float | None, digits: int = 0) -> str:
    """A length in millimetres."""
    return (
        f"{metres * 1e3:.{digits}f} mm"
        if metres is not None and np.isfinite(metres)
        else UNKNOWN
    )


def ms(seconds: float, digits: int = 0) -> str:
    """A time in milliseconds."""
    return f"{seconds * 1e3:.{digits}f} ms" if np.isfinite(seconds) else UNKNOWN


def mean_with_interval(row: Mapping[str, Any]) -> str:
    """A mean with its interval, where it has one. row: of `outcomes.response`."""
    ends = (
        f" ({significant(row['low'])} to {significant(row['high'])})"
        if np.isfinite(row["low"])
        else ""
    )
    return significant(row["mean"]) + ends


def rate(share: float | None) -> str:
    """A matching rate E to three decimals, or that it is not known."""
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
    return (
        Markup("<i>{}</i><sub>{}</sub>").format(stem, index)
        if index
        else Markup("<i>{}</i>").format(stem)
    )


def sentence(text: str) -> Markup:
    """A sentence with the symbols in it set as symbols."""
    return Markup(
        re.sub(r"\b[kcC]_\w+\b", lambda found: str(symbol(found[0])), str(escape(text)))
    )


def unit(text: str) -> Markup:
    """N s2/(m2 kg) with its powers set high."""
    return Markup(re.sub(r"(?<=[a-z])(\d)", r"<sup>\1</sup>", str(escape(text))))


def unread(readings: pd.DataFrame) -> list[dict[str, Any]]:
    """Frames that could not be read: how many for each reason, and when [ms]."""
    bad = readings[~readings["valid"].astype(bool)]
    said = []
    for reason, rows in bad.groupby("reason", sort=False):
        t = [f"{at * 1e3:.0f}" for at in rows["t"]]
        # between stretches of consecutive frames
        breaks = np.flatnonzero(np.diff(rows["frame"]) != 1) + 1
        stretches = pairwise([0, *breaks, len(rows)])
        when = [
            t[first] if end - first == 1 else f"{t[first]} to {t[end - 1]}"
            for first, end in stretches
        ]
        said.append({"reason": reason, "count": len(rows), "when": ", ".join(when)})
    return said


def flatten_settings(
    block: Mapping[str, Any], place: str = ""
) -> Iterator[tuple[str, str]]:
    """Every setting by the name it has on the command line, in the order in which a run
    keeps them.
    """
    for name, value in sorted(block.items()):
        if isinstance(value, Mapping) and value:
            yield from flatten_settings(value, f"{place}{name}.")
        else:
            yield f"{place}{name}", "null" if value is None else str(value)


# --- of a diagnosis
def plain(name: str) -> str:
    """An effect, or several joined by ' + ', in plain words."""
    return OUTCOMES.get(name, name.replace("_", " "))


def percent(share: float) -> str:
    """A probability or share; what is small or nearly certain in words."""
    if not np.isfinite(share):
        return UNKNOWN
    return (
        "under 1 %"
        if share < 0.005
        else "over 99 %"
        if 0.995 < share < 1
        else f"{100 * share:.0f} %"
    )


def gain(value: float, unknown: str = UNKNOWN) -> str:
    """A log-likelihood, its thousands apart."""
    return (
        f"{value:,.0f}".replace(",", "\u202f").replace("-", "−")
        if np.isfinite(value)
        else unknown
    )


def quantity(row: Mapping[str, Any]) -> tuple[Markup, Markup]:
    """A value and its 95 % interval in handy units, with as many figures as the
    interval is worth; the lower end alone where that is what is known. row: of table
    CAUSES.
    """
    factor, name = HANDY.get(row["unit"], (1.0, row["unit"]))
    value, low, high = within(*(factor * row[of] for of in ("value", "low", "high")))
    ends = f"at least {low}" if row.get("at_least") else f"{low} to {high}"
    with_unit = [
        Markup("{} {}").format(figures, unit(name)).strip() for figures in (value, ends)
    ]
    return with_unit[0], Markup(UNKNOWN) if UNKNOWN in (low, high) else with_unit[1]


def within(value: float, low: float, high: float) -> list[str]:
    """A value and the ends of its interval, to two figures of the interval's width;
    each to its own three where the interval is not known or spans more than a power of
    ten.
    """
    width, largest = high - low, max(abs(low), abs(high), abs(value))
    if not (np.isfinite(largest) and width > 0) or (
        low * high > 0 and not 0.1 < low / high < 10
    ):
        return [significant(one).replace("-", "−") for one in (value, low, high)]
    power = int(np.floor(np.log10(largest)))
    power *= not -3 <= power < 4
    decimals = max(0, 1 - int(np.floor(np.log10(width))) + power)
    raised = f" × 10{superscript(str(power))}" if power else ""
    return [
        f"{one / 10.0**power:.{decimals}f}{raised}".replace("-", "−")
        for one in (value, low, high)
    ]


def headline(document: Mapping[str, Any]) -> str:
    """The verdict in a few words. document: diagnosis.json."""
    groups = document["indistinguishable"]
    alike = {name for group in groups for name in group}
    certain = [
        plain(cause["effect"])
        for cause in document["causes"]
        if cause["effect"] not in alike
    ]
    causes = enumerated(
        [
            *certain,
            *(enumerated([plain(name) for name in group], "or") for group in groups),
        ]
    )
    if document.get("interrupted"):
        return "The search for causes was interrupted"
    return {
        "none": "The simulation agrees with what was measured",
        "effect": f"The cause: {causes}"
        if len(certain) == 1
        else f"The causes: {causes}",
        "ambiguous": f"{causes.capitalize()}: this data cannot tell them apart",
        "unknown": "Something is missing, and it is not in the library",
        "insufficient": "This data cannot answer",
    }[document["verdict"]]


def enumerated(names: Sequence[str], word: str = "and") -> str:
    """Names as `a, b and c`."""
    return f" {word} ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))
