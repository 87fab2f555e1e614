"""The result of a check: a finding."""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum


class Severity(StrEnum):
    """error: certainly wrong, nothing runs on it. warning: suspicious, or left out.
    note: good to know.
    """

    ERROR = "error"
    WARNING = "warning"
    NOTE = "note"


@dataclass(frozen=True)
class Finding:
    """One thing that was found.

    file: where. field: column or key there; empty if it is about the whole file. said:
    what is so. remedy: what to do; findings of several trials with the same remedy are
    told as one. trials: in which; empty if in all of the data.
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
        where = f" (trial {', '.join(self.trials)})" if self.trials else ""
        return (
            f"{place}{where}: {self.statement}. {self.remedy}{full_stop(self.remedy)}"
        )


def full_stop(remedy: str) -> str:
    """The full stop behind a remedy; none behind a command, which is to be pasted."""
    return "" if re.search(r": (python|rm|printf) \S", remedy) else "."
