"""Check that every number in the settings lies within its bounds.

Bounds stand where a setting is declared, in its comment in `conf`, before its unit:
`fps: 200.0  # frame rate, 0.1 to 1e5 [1/s]`. Bounds of a block hold for all numbers in
it that have none of their own.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from stringcast.pipeline.settings.composition import (
    Settings,
    UserError,
    conf_folders,
    flatten_settings,
)
from stringcast.pipeline.settings.setting_comments import setting_comments

NUMBER = r"-?\d+(?:\.\d+)?(?:e-?\d+)?"
BOUNDS = re.compile(rf"(?:^|, )({NUMBER}) to ({NUMBER})(?: \[([^\]]+)\]|;|$)")
REFERENCE = re.compile(r"\$\{([\w.]+)\}")  # a value that refers to another setting
WORDS = {"trials_used": ("all",)}  # words accepted instead of a number


class Bounds(NamedTuple):
    """The inclusive bounds of a setting, and its unit, if any."""

    low: float
    high: float
    unit: str

    def describe(self) -> str:
        """Return the bounds with the unit."""
        return f"from {self.low:g} to {self.high:g} {self.unit}".rstrip()


def bounds_of(name: str) -> Bounds | None:
    """Return the bounds of a setting, or of the nearest block around it with bounds."""
    while name:
        found = BOUNDS.search(setting_comments().get(name, ""))
        if found:
            unit = found[3] if found[3] and found[3] != "1" else ""
            return Bounds(float(found[1]), float(found[2]), unit)
        name = name.rpartition(".")[0]
    return None


def refuse_numbers_out_of_bounds(config: Settings, where: Callable[[str], str]) -> None:
    """Raise UserError for a setting outside its bounds, or not a number.

    The message names the setting that was given, not one that refers to it. `where`
    returns the file of a block of settings, for messages.
    """
    faults = {}
    references = _referenced_settings(conf_folders())
    for name, value in flatten_settings(dict(config)).items():
        bounds = bounds_of(name) or bounds_of(_follow(name, references))
        if bounds is not None and value not in WORDS.get(name, ()):
            fault = _fault(value, bounds)
            if fault:
                faults[name] = fault
    for name, (value, requirement) in faults.items():
        original = _follow(name, references)
        if original == name or original not in faults:
            place = where(name.partition(".")[0])
            raise UserError(
                f"{name} = {value} ({place})",
                f"it must be {requirement}",
                "Change it there or on the command line.",
            )


def _follow(name: str, references: Mapping[str, str]) -> str:
    """Return the name of the setting that a setting refers to, or its own name."""
    block = name
    while block:
        if block in references:
            return references[block] + name[len(block) :]
        block = block.rpartition(".")[0]
    return name


def _fault(value: Any, bounds: Bounds) -> tuple[str, str] | None:
    """Return a wrong number and its requirement; None if all are right."""
    for number in _leaves(value):
        if isinstance(number, bool) or not isinstance(number, int | float):
            return repr(number), f"a number {bounds.describe()}"
        if not bounds.low <= number <= bounds.high:
            is_huge = isinstance(number, int) and abs(number) > sys.float_info.max
            shown = "a number beyond 1e308" if is_huge else f"{number:g}"
            return shown, bounds.describe()
    return None


def _leaves(value: Any) -> Iterator[Any]:
    """Yield the values in nested lists and blocks; none for a missing setting."""
    if isinstance(value, Mapping):
        yield from _leaves(list(value.values()))
    elif isinstance(value, list | tuple):
        for inner in value:
            yield from _leaves(inner)
    elif value is not None:
        yield value


@cache
def _referenced_settings(folders: tuple[Path, ...]) -> dict[str, str]:
    """Return the settings that refer to another one, with its name."""
    references = {}
    for folder in folders:
        for file in sorted(folder.rglob("*/*.yaml")):
            block = file.parent.relative_to(folder).as_posix()
            content = yaml.safe_load(file.read_text(encoding="utf-8")) or {}
            for name, value in flatten_settings(content, block).items():
                found = REFERENCE.fullmatch(value) if isinstance(value, str) else None
                if found:
                    references[name] = found[1]
    return references
