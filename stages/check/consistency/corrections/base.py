"""The interface of a correction of a common mistake."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable

from stringcast.stages.check.consistency.record import Measurements


class Correction(ABC):
    """A common mistake and its correction.

    `import` finds the option for a correction by its class.

    Attributes
    ----------
    table, field
        Table and field of the mistake.
    statement
        The mistake in words.
    remedy
        How to correct it in the files of a dataset.
    """

    table: str
    field: str
    statement: str
    remedy: str

    @abstractmethod
    def undo(self, measured: Measurements) -> Measurements | None:
        """Return measurements without the mistake; None if it is impossible."""


def apply_corrections(
    measured: Measurements, corrections: Iterable[Correction]
) -> Measurements | None:
    """Correct mistakes one after another; None if one of them is impossible."""
    for correction in corrections:
        corrected = correction.undo(measured)
        if corrected is None:
            return None
        measured = corrected
    return measured
