"""Errors that a user can correct, and their messages.

Every command loads this module, so it imports nothing heavy.
"""

from __future__ import annotations

import difflib
import errno
from collections.abc import Sequence
from pathlib import Path

DEFAULT_REMEDY = "Look at the disk, or choose another folder"
REMEDIES = {
    errno.ENOSPC: "Free space on the disk, or choose another folder",
    errno.EDQUOT: "Free space within your quota, or choose another folder",
    errno.EACCES: "Choose a folder that you may write to",
    errno.EPERM: "Choose a folder that you may write to",
    errno.EROFS: "Choose a folder that you may write to",
}


class ExpectedError(Exception):
    """An error that the user can correct; its text is `place: fault. Remedy.`.

    Parameters
    ----------
    place : str or Path
        A file, an option, a setting or a device; empty if it is none of them.
    fault : str
        What is wrong, without a full stop.
    remedy : str
        What to do, in whole sentences or as a command at their end.
    field : str
        Column, key or line at fault; empty if it is none or unknown.
    """

    def __init__(
        self, place: str | Path, fault: str, remedy: str = "", field: str = ""
    ) -> None:
        super().__init__(place, fault, remedy, field)
        self.place = str(place)
        self.fault = fault
        self.remedy = remedy
        self.field = field

    def __str__(self) -> str:
        """Return place, fault and remedy as sentences."""
        sentence = f"{self.place}: " if self.place else ""
        sentence += self.fault
        if not self.fault.endswith((".", "?")):
            sentence += "."
        return f"{sentence} {self.remedy}".rstrip()


def remedy_for(error: BaseException) -> str:
    """Choose the remedy for a failed write by its error number."""
    return REMEDIES.get(getattr(error, "errno", None) or 0, DEFAULT_REMEDY)


def suggest_known_name(name: str, known: Sequence[str]) -> str:
    """Suggest the nearest known name, or list all."""
    if near := difflib.get_close_matches(name, known, 1):
        return f"Did you mean '{near[0]}'?"
    return f"Known are: {', '.join(known)}."


def escape_control_characters(text: str) -> str:
    """Escape control characters of foreign text, as they would act on the terminal."""
    return "".join(map(_printable_character, text))


def _printable_character(character: str) -> str:
    if character.isprintable() or character in "\n\t":
        return character
    return repr(character)[1:-1]
