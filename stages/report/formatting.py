"""Format numbers, symbols, units, settings and verdicts for readers."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup, escape

from stringcast.stages.common import readable_name

NOT_KNOWN = "not known"
DISPLAY_UNITS = {
    "s": (1e3, "ms"),
    "m": (1e3, "mm"),
    "rad": (180 / np.pi, "°"),
    "1": (1.0, ""),
}
VERDICT_NAMES = {
    "none": "no cause",
    "unknown": "a cause that the library does not contain",
}
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


# --- numbers
def format_mm(metres: float | None, digits: int = 0) -> str:
    """Format a length in millimetres."""
    return _format_scaled(metres, 1e3, digits, " mm")


def format_ms(seconds: float, digits: int = 0) -> str:
    """Format a time in milliseconds."""
    return _format_scaled(seconds, 1e3, digits, " ms")


def format_rate(share: float | None) -> str:
    """Format a matching rate E to three decimals."""
    return _format_scaled(share, 1.0, 3, "")


def _format_scaled(value: float | None, factor: float, digits: int, unit: str) -> str:
    if value is None or not np.isfinite(value):
        return NOT_KNOWN
    return f"{value * factor:.{digits}f}{unit}"


def format_percent(share: float) -> str:
    """Format a probability or share, with words for very small and very large ones."""
    if not np.isfinite(share):
        return NOT_KNOWN
    if share < 0.005:
        return "under 1 %"
    if 0.995 < share < 1:
        return "over 99 %"
    return f"{100 * share:.0f} %"


def format_gain(value: float, unknown: str = NOT_KNOWN) -> str:
    """Format a log-likelihood, with spaces between thousands."""
    if not np.isfinite(value):
        return unknown
    return f"{value:,.0f}".replace(",", "\u202f").replace("-", "−")


def format_count(number: int, noun: str) -> str:
    """Format a number of things: 1 trial, 2 trials."""
    return f"{number} {noun}{'s' * (number != 1)}"


def format_value(value: float) -> str:
    """Format three significant figures, with a power of ten if that is shorter."""
    if not np.isfinite(value):
        return NOT_KNOWN
    if value == 0 or 1e-3 <= abs(value) < 1e4:
        rounded = f"{value:.3g}"
        return rounded if abs(value) < 1000 else f"{float(rounded):.0f}"
    figures, power = f"{value:.2e}".split("e")
    return f"{float(figures):g} × 10{superscript(power)}"


def format_hit_probability(plan: Mapping[str, Any]) -> str:
    """Format the predicted hit probability of a motion; empty if it is unknown."""
    chance = plan.get("chance", np.nan)
    if not np.isfinite(chance):
        return ""
    return f"{chance:.2f} ({plan['chance_low']:.2f} to {plan['chance_high']:.2f})"


def format_mean(row: Mapping[str, Any]) -> str:
    """Format a mean with its interval, if any, from a row of `mean_response`."""
    mean = format_value(row["mean"])
    if not np.isfinite(row["low"]):
        return mean
    return f"{mean} ({format_value(row['low'])} to {format_value(row['high'])})"


def format_quantity(row: Mapping[str, Any]) -> tuple[Markup, Markup]:
    """Format value and 95 % interval in convenient units, from a row of table CAUSES.

    They have as many figures as the interval justifies. The interval may be one-sided.
    """
    factor, name = DISPLAY_UNITS.get(row["unit"], (1.0, row["unit"]))
    scaled = [factor * row[column] for column in ("value", "low", "high")]
    value, low, high = format_interval(*scaled)
    interval = f"at least {low}" if row["at_least"] else f"{low} to {high}"
    if NOT_KNOWN in (low, high):
        return _with_unit(value, name), Markup(NOT_KNOWN)
    return _with_unit(value, name), _with_unit(interval, name)


def _with_unit(figures: str, name: str) -> Markup:
    return Markup("{} {}").format(figures, unit_markup(name)).strip()


def format_interval(value: float, low: float, high: float) -> list[str]:
    """Format a value and the ends of its interval to two figures of its width.

    If the interval is unknown or spans more than a power of ten, each number has three
    significant figures.
    """
    width, largest = high - low, max(abs(low), abs(high), abs(value))
    is_known = np.isfinite(largest) and width > 0
    spans_decade = low * high > 0 and not 0.1 < low / high < 10
    if not is_known or spans_decade:
        return [format_value(number).replace("-", "−") for number in (value, low, high)]

    power = int(np.floor(np.log10(largest)))
    if -3 <= power < 4:
        power = 0
    decimals = max(0, 1 - int(np.floor(np.log10(width))) + power)
    suffix = f" × 10{superscript(str(power))}" if power else ""
    scaled = [f"{number / 10.0**power:.{decimals}f}" for number in (value, low, high)]
    return [(figures + suffix).replace("-", "−") for figures in scaled]


def superscript(number: str) -> str:
    """Return the superscript digits of an exponent, without leading zeros."""
    return str(int(number)).translate(SUPERSCRIPTS)


# --- symbols and units
def symbol_markup(name: str) -> Markup:
    """Format a symbol such as k_ph, with its index as a subscript."""
    stem, _, index = name.partition("_")
    if index:
        return Markup("<i>{}</i><sub>{}</sub>").format(stem, index)
    return Markup("<i>{}</i>").format(stem)


def sentence_markup(text: str) -> Markup:
    """Format the symbols in a sentence."""
    symbols = r"\b[kcC]_\w+\b"
    marked = re.sub(
        symbols, lambda found: str(symbol_markup(found[0])), str(escape(text))
    )
    return Markup(marked)


def unit_markup(text: str) -> Markup:
    """Format a unit such as N s2/(m2 kg), with its powers as superscripts."""
    return Markup(re.sub(r"(?<=[a-z])(\d)", r"<sup>\1</sup>", str(escape(text))))


# --- settings and verdicts
def setting_texts(
    block: Mapping[str, Any], prefix: str = ""
) -> Iterator[tuple[str, str]]:
    """List settings in nested blocks by their names on the command line."""
    for name, value in sorted(block.items()):
        if isinstance(value, Mapping) and value:
            yield from setting_texts(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", "null" if value is None else str(value)


def effect_title(name: str) -> str:
    """Spell out the name of an effect or verdict, or several joined by ' + '."""
    return VERDICT_NAMES.get(name, readable_name(name))


def join_names(names: Sequence[str], word: str = "and") -> str:
    """Join names as `a, b and c`."""
    head = ", ".join(names[:-1])
    return f" {word} ".join(filter(None, (head, *names[-1:])))


def join_effects(names: Sequence[str], word: str = "and") -> str:
    """Join names of effects as `wind, arm lag and tip mass`."""
    return join_names([effect_title(name) for name in names], word)


def verdict_headline(document: Mapping[str, Any]) -> str:
    """State the verdict of diagnosis.json in a few words."""
    if document["interrupted"]:
        return "The search for causes was interrupted"
    groups = document["indistinguishable"]
    in_groups = {name for group in groups for name in group}
    causes = [cause["effect"] for cause in document["causes"]]
    certain = [effect_title(name) for name in causes if name not in in_groups]
    found = f"Found: {', '.join(certain)}"
    undecided = f"Undecided: {'; '.join(join_effects(group, 'or') for group in groups)}"
    named = f"{found}. {undecided}" if certain and groups else found
    if not certain:
        named = undecided
    return {
        "none": "The simulation agrees with the measurements",
        "effect": found,
        "ambiguous": named,
        "partial": f"Partly explained. {named}",
        "unknown": "The simulation has an error of unknown cause",
        "insufficient": "The data do not allow a diagnosis",
    }[document["verdict"]]
