"""Findings of the checks."""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum

from stringcast.data.errors import ExpectedError

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
    def place(self) -> str:
        """File and field, with the names of a few trials."""
        place = " ".join(filter(None, (self.file, self.field)))
        if self.trials:
            names = ", ".join(self.trials[:MAX_NAMED_TRIALS])
            more = len(self.trials) - MAX_NAMED_TRIALS
            others = f" and {more} more" if more > 0 else ""
            place += f" (trial {names}{others})"
        return place

    @property
    def advice(self) -> str:
        """The remedy as a sentence; a command to be pasted has no full stop."""
        ends_in_command = re.search(r": (python|rm|printf) \S", self.remedy)
        return self.remedy if ends_in_command or not self.remedy else f"{self.remedy}."

    @property
    def sentence(self) -> str:
        """The finding in one line."""
        return str(ExpectedError(self.place, self.statement, self.advice))


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
