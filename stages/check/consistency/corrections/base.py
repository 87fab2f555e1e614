"""What a correction of a common mistake is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable

from stringcast.stages.check.consistency.record import Measurements


class Correction(ABC):
    """A common mistake and its undoing.

    `import` knows the option that undoes a mistake by its class.

    Attributes
    ----------
    table, field
        Where the mistake was made.
    statement
        What is wrong.
    remedy
        How to undo it in the files of a dataset.
    """

    table: str
    field: str
    statement: str
    remedy: str

    @abstractmethod
    def undo(self, measured: Measurements) -> Measurements | None:
        """Return measurements without the mistake; None if it cannot be there."""


def apply_corrections(
    measured: Measurements, corrections: Iterable[Correction]
) -> Measurements | None:
    """Undo mistakes one after another; None if one of them cannot be there."""
    for correction in corrections:
        corrected = correction.undo(measured)
        if corrected is None:
            return None
        measured = corrected
    return measured
