"""All checks of measured data, and what follows from them. A check more is a function
more in CHECKS.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

from stringcast.data.schema import DataError
from stringcast.stages.check import clocks, contents, frames, mistakes, motion
from stringcast.stages.check.finding import Finding, Severity
from stringcast.stages.check.measured import CheckedDataset

Check = Callable[[CheckedDataset], Iterator[Finding]]
CHECKS: tuple[Check, ...] = (
    mistakes.check_mistakes,
    mistakes.check_angles,
    clocks.check_time_unit,
    clocks.check_duration,
    clocks.check_sampling,
    motion.check_wrapped_angles,
    contents.check_noise,
    contents.check_empty_tables,
    contents.check_rejected_trials,
    contents.check_string_length,
    contents.check_arm,
    contents.check_hand_tables,
    contents.check_camera,
    contents.check_names,
    contents.check_roles,
    contents.check_trial_count,
    clocks.check_rest,
    clocks.check_onsets,
    clocks.check_overlap,
    clocks.check_frame_rate,
    motion.check_fall,
    motion.check_hanging,
    motion.check_frozen_joints,
    motion.check_repeated_points,
    motion.check_stillness,
    contents.check_duplicate_tables,
    contents.check_rows,
    clocks.check_clock_start,
    clocks.check_gaps,
    frames.check_dropped_frames,
    frames.check_camera_view,
)


def collect_findings(measured: CheckedDataset) -> list[Finding]:
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


def refuse_errors(measured: CheckedDataset) -> None:
    """Raise DataError where something is certainly wrong."""
    errors = [
        finding
        for finding in collect_findings(measured)
        if finding.severity is Severity.ERROR
    ]
    if errors:
        place = measured.data.folder
        more = (
            f" {len(errors) - 1} more:" if len(errors) > 1 else " All that was found:"
        )
        raise DataError(
            f"{place}: {errors[0].sentence}{more} python -m pipeline check {place}"
        )
