"""Checks of single samples: lost points, rows of zeros, outliers, coarse positions."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from stringcast.data.artifacts import JOINTS
from stringcast.data.rows import spike_mask
from stringcast.stages.check.finding import Finding, error, note, warning
from stringcast.stages.check.measured import SUSPICIOUS_LOST_SHARE, CheckedDataset
from stringcast.stages.model.polyline import step_lengths

GROSS_OUTLIER = 0.05  # distance from its neighbours' middle, relative to the length
MIN_OUTLIERS = 3
COARSE_STEP = 0.005  # of a grid of positions, relative to the length
MIN_GRID_VALUES = 5
GRID_TOLERANCE = 0.01  # of a step: values this near to a grid point are on it
MAX_LISTED_TRIALS = 4  # trials whose counts are listed


def check_lost_points(dataset: CheckedDataset) -> Iterator[Finding]:
    """Find lost points that a tracker repeated or replaced by a fixed position."""
    for file, rows in dataset.data.row_counts.items():
        for kind in dict.fromkeys(lost.kind for lost in rows.lost):
            found = [lost for lost in rows.lost if lost.kind == kind]
            counts = []
            for lost in found[:MAX_LISTED_TRIALS]:
                counts.append(
                    f"{lost.trial}: {lost.count} of {lost.total}, for up to "
                    f"{lost.longest:.2f} s"
                )
            if len(found) > len(counts):
                counts.append(f"{len(found) - len(counts)} more trials")
            listed = "; ".join(counts)
            statement = (
                f"the tracker wrote {kind} where it lost a point, and these are left "
                f"out ({listed})"
            )
            remedy = f"Set 'valid' to false, or leave the row out, instead of {kind}"
            share = max(lost.count / lost.total for lost in found)
            report = warning if share > SUSPICIOUS_LOST_SHARE else note
            trials = [lost.trial for lost in found]
            yield report(file, "x, y", statement, remedy, *trials)


def check_zero_rows(dataset: CheckedDataset) -> Iterator[Finding]:
    """Find single rows of the hand's log that are exactly zero."""
    counts = {}
    speed = 0.0
    for trial in dataset.trials:
        is_zero = trial.zero_rows
        if is_zero.any():
            rows = trial.logged_motion
            if trial.joints is None:
                places = rows[["x", "y"]].to_numpy()
            else:
                places = dataset.arm.grasp_pose(rows[list(JOINTS)].to_numpy())[:, :2]
            steps = step_lengths(places)
            speed = max(speed, float(np.max(steps / np.diff(rows["t"]))))
            counts[trial.name] = f"{is_zero.sum()} of {len(is_zero)} rows"
    if not counts:
        return
    has_poses = dataset.trials[0].joints is None
    columns = ["x", "y", "theta"] if has_poses else list(JOINTS)
    listed = [f"{name}: {count}" for name, count in counts.items()]
    statement = (
        f"single rows are exactly zero, as if from a second publisher "
        f"({'; '.join(listed[:MAX_LISTED_TRIALS])}), and the hand would move with "
        f"{speed:.3g} m/s"
    )
    code = _code_without_zeros(dataset.data.folder / dataset.hand_file, columns)
    remedy = f"Leave them out: python -c {shlex.quote(code)}"
    yield error(dataset.hand_file, ", ".join(columns), statement, remedy, *counts)


def _code_without_zeros(path: Path, columns: Sequence[str]) -> str:
    """Return Python code that removes rows of zeros from a file."""
    read, write = "read_parquet(f)", "to_parquet(f)"
    if path.suffix == ".csv":
        read, write = "read_csv(f)", "to_csv(f, index=False)"
    return (
        f"import pandas as p; f = {json.dumps(str(path))}; a = p.{read}; "
        f"a[a[{json.dumps(columns)}].any(axis=1)].{write}"
    )


def check_outliers(dataset: CheckedDataset) -> Iterator[Finding]:
    """Count positions that jump away and back at once."""
    for trial in dataset.with_points():
        count = total = 0
        farthest = 0.0
        for t, xy in trial.tracks:
            middle = (xy[:-2] + xy[2:]) / 2
            distance = np.linalg.norm(xy[1:-1] - middle, axis=1)
            is_gross = distance > GROSS_OUTLIER * trial.length
            is_outlier = spike_mask(t, xy)[1:-1] & is_gross
            count += int(is_outlier.sum())
            total += len(xy)
            farthest = max(farthest, float(distance[is_outlier].max(initial=0.0)))
        if count >= MIN_OUTLIERS:
            statement = (
                f"{count} of {total} positions ({count / total:.1%}) jump away and "
                f"back at once, by up to {farthest:.2g} m"
            )
            remedy = (
                "A diagnosis leaves outliers out; see whether the tracker takes "
                "something else for the point"
            )
            yield note(dataset.points_file, "x, y", statement, remedy, trial.name)


def check_resolution(dataset: CheckedDataset) -> Iterator[Finding]:
    """Find coordinates that come in coarse steps."""
    for trial in dataset.with_points():
        steps = [grid_step(trial.points[axis].to_numpy()) for axis in ("x", "y")]
        step = max(steps)
        if step > COARSE_STEP * trial.length:
            statement = (
                f"positions come in steps of {step:.3g} m; their noise is at least "
                f"{step / np.sqrt(12):.2g} m"
            )
            remedy = "Write more digits, or track parts of a pixel, if you can"
            yield note(dataset.points_file, "x, y", statement, remedy, trial.name)


def grid_step(values: np.ndarray) -> float:
    """Return the step of a grid on which all values (N,) lie; 0 if there is none."""
    distinct = np.unique(values[np.isfinite(values)])
    if len(distinct) < MIN_GRID_VALUES:
        return 0.0
    steps = np.diff(distinct)
    step = float(steps.min())
    multiples = steps / step
    is_whole = np.abs(multiples - np.rint(multiples)) < GRID_TOLERANCE
    # with few repeated values, all steps may be multiples by chance
    is_grid = is_whole.all() and len(distinct) < len(values) / 2
    return step if is_grid else 0.0
