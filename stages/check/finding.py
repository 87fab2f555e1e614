"""Findings of the checks."""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum

MAX_NAMED_TRIALS = 4  # in a sentence


class Severity(StrEnum):
    """How bad a finding is.

    An error is certain, and nothing runs on such data. A warning is a suspicion, or
    means that data are left out. A note needs no action.
    """

    ERROR = "error"
    WARNING = "warning"
    NOTE = "note"


@dataclass(frozen=True)
class Finding:
    """A fault or peculiarity that a check found in the data.

    field: column or key in the file; empty if all of it is concerned. trials: those
    that it concerns; empty if it concerns all of the data.
    """

    severity: Severity
    file: str
    field: str
    statement: str
    remedy: str
    trials: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """The finding in one line, with the names of a few trials."""
        place = " ".join(filter(None, (self.file, self.field)))
        if self.trials:
            names = ", ".join(self.trials[:MAX_NAMED_TRIALS])
            more = len(self.trials) - MAX_NAMED_TRIALS
            others = f" and {more} more" if more > 0 else ""
            place += f" (trial {names}{others})"
        sentence = f"{place}: " if place else ""
        sentence += f"{self.statement}."
        if self.remedy:
            sentence += f" {self.remedy}{full_stop(self.remedy)}"
        return sentence


def error(file: str, field: str, statement: str, remedy: str, *trials: str) -> Finding:
    """Return a finding that stops a run."""
    return Finding(Severity.ERROR, file, field, statement, remedy, trials)


def warning(
    file: str, field: str, statement: str, remedy: str, *trials: str
) -> Finding:
    """Return a finding that is suspicious."""
    return Finding(Severity.WARNING, file, field, statement, remedy, trials)


def note(file: str, field: str, statement: str, remedy: str, *trials: str) -> Finding:
    """Return a finding that needs no action."""
    return Finding(Severity.NOTE, file, field, statement, remedy, trials)


def full_stop(remedy: str) -> str:
    """Return the full stop after a remedy; none after a command to be pasted."""
    return "" if re.search(r": (python|rm|printf) \S", remedy) else "."
