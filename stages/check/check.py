"""All checks of measured data. To add a check, add its function to CHECKS."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache

from stringcast.data.schema import DataError
from stringcast.stages.check import (
    clocks,
    contents,
    frames,
    motion,
    rest_shape,
    samples,
)
from stringcast.stages.check.consistency import check as consistency
from stringcast.stages.check.consistency.trial_clocks import check_trial_clocks
from stringcast.stages.check.finding import Finding, Severity
from stringcast.stages.check.measured import CheckedDataset

Check = Callable[[CheckedDataset], Iterator[Finding]]
CHECKS: tuple[Check, ...] = (
    consistency.check_consistency,
    consistency.check_angles,
    clocks.check_time_unit,
    clocks.check_duration,
    clocks.check_sampling,
    motion.check_wrapped_angles,
    contents.check_noise,
    contents.check_empty_tables,
    contents.check_rejected_trials,
    contents.check_string_length,
    rest_shape.check_resting_length,
    rest_shape.check_mark_places,
    contents.check_arm,
    contents.check_hand_tables,
    contents.check_names,
    contents.check_roles,
    contents.check_trial_count,
    clocks.check_rest,
    clocks.check_onsets,
    clocks.check_clock_interval,
    check_trial_clocks,
    clocks.check_overlap,
    clocks.check_frame_rate,
    motion.check_fall,
    motion.check_frozen_joints,
    samples.check_lost_points,
    samples.check_zero_rows,
    samples.check_outliers,
    samples.check_resolution,
    motion.check_stillness,
    contents.check_duplicate_tables,
    contents.check_rows,
    clocks.check_clock_start,
    clocks.check_gaps,
    clocks.check_bandwidth,
    frames.check_dropped_frames,
    frames.check_camera_view,
)


def collect_findings(dataset: CheckedDataset) -> list[Finding]:
    """Return the findings of all checks of a dataset, the worst first.

    Findings with the same place and remedy are merged: the statement is that of the
    first, for all their trials.
    """
    return [*_run_checks(dataset)]


@lru_cache(maxsize=4)
def _run_checks(dataset: CheckedDataset) -> tuple[Finding, ...]:
    merged: dict[tuple[str, ...], Finding] = {}
    for check in CHECKS:
        for finding in check(dataset):
            key = (finding.severity, finding.file, finding.field, finding.remedy)
            first = merged.setdefault(key, finding)
            trials = dict.fromkeys((*first.trials, *finding.trials))
            merged[key] = replace(first, trials=tuple(trials))
    order = list(Severity)
    worst_first = sorted(merged.values(), key=lambda f: order.index(f.severity))
    return tuple(worst_first)


def refuse_errors(dataset: CheckedDataset) -> None:
    """Raise DataError if a check of a dataset finds an error."""
    findings = collect_findings(dataset)
    errors = [finding for finding in findings if finding.severity is Severity.ERROR]
    if errors:
        worst, folder = errors[0], dataset.data.folder
        more = f"{len(errors) - 1} more" if len(errors) > 1 else "All findings"
        command = f"python -m pipeline check {shlex.quote(str(folder))}"
        raise DataError(
            folder,
            f"{worst.place}: {worst.statement}",
            f"{worst.advice} {more}: {command}",
        )
