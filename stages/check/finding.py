"""Findings of the checks."""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum


class Severity(StrEnum):
    """How bad a finding is.

    An error is certainly wrong, and nothing runs on such data. A warning is suspicious
    or means that data are left out. A note needs no action.
    """

    ERROR = "error"
    WARNING = "warning"
    NOTE = "note"


@dataclass(frozen=True)
class Finding:
    """A fault or peculiarity that a check found in the data.

    Attributes
    ----------
    severity
        How bad it is.
    file
        The file that it concerns.
    field
        The column or key there; empty if it concerns the whole file.
    statement
        What was found.
    remedy
        What to do about it.
    trials
        The trials that it concerns; empty if it concerns all of the data.
    """

    severity: Severity
    file: str
    field: str
    statement: str
    remedy: str
    trials: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """The finding in one line."""
        place = " ".join(filter(None, (self.file, self.field)))
        trials = f" (trial {', '.join(self.trials)})" if self.trials else ""
        end = full_stop(self.remedy)
        return f"{place}{trials}: {self.statement}. {self.remedy}{end}"


def error(file: str, field: str, statement: str, remedy: str, *trials: str) -> Finding:
    """Return a finding that stops a run."""
    return Finding(Severity.ERROR, file, field, statement, remedy, trials)


def warning(
    file: str, field: str, statement: str, remedy: str, *trials: str
) -> Finding:
    """Return a finding that is suspicious."""
    return Finding(Severity.WARNING, file, field, statement, remedy, trials)


def note(file: str, field: str, statement: str, remedy: str, *trials: str) -> Finding:
    """Return a finding that is good to know."""
    return Finding(Severity.NOTE, file, field, statement, remedy, trials)


def full_stop(remedy: str) -> str:
    """Return the full stop behind a remedy; none behind a command to be pasted."""
    return "" if re.search(r": (python|rm|printf) \S", remedy) else "."
