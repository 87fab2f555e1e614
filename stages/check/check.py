"""All checks of measured data, and what follows from them. A check more is a function
more in CHECKS.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

from stringcast.data.schema import DataError
from stringcast.stages.check import clocks, contents, frames, mistakes, motion
from stringcast.stages.check.finding import Finding, Severity
from stringcast.stages.check.measured import Measured

Check = Callable[[Measured], Iterator[Finding]]
CHECKS: tuple[Check, ...] = (
    mistakes.mistakes,
    mistakes.angles,
    clocks.unit,
    clocks.lasting,
    clocks.scarce,
    motion.wrapped,
    contents.noise,
    contents.empty,
    contents.rejected,
    contents.length,
    contents.arm,
    contents.hands,
    contents.camera,
    contents.names,
    contents.roles,
    contents.one_trial,
    clocks.rest,
    clocks.together,
    clocks.overlap,
    clocks.rate,
    motion.falls,
    motion.hangs,
    motion.frozen,
    motion.held,
    motion.still,
    contents.twice,
    contents.rows,
    clocks.begun,
    clocks.gaps,
    frames.dropped,
    frames.shown,
)


def findings(measured: Measured) -> list[Finding]:
    """Findings of all checks, the worst first; those of the same place with the same
    remedy as one, in the words of the first.
    """
    whole: dict[tuple[str, ...], Finding] = {}
    for finding in (finding for check in CHECKS for finding in check(measured)):
        key = (finding.severity, finding.file, finding.field, finding.remedy)
        first = whole.setdefault(key, finding)
        whole[key] = replace(
            first, trials=tuple(dict.fromkeys((*first.trials, *finding.trials)))
        )
    return sorted(
        whole.values(), key=lambda finding: list(Severity).index(finding.severity)
    )


def refuse(measured: Measured) -> None:
    """Raise DataError where something is certainly wrong."""
    errors = [
        finding for finding in findings(measured) if finding.severity is Severity.ERROR
    ]
    if errors:
        place = measured.data.folder
        more = (
            f" {len(errors) - 1} more:" if len(errors) > 1 else " All that was found:"
        )
        raise DataError(
            f"{place}: {errors[0].sentence}{more} python -m pipeline check {place}"
        )
