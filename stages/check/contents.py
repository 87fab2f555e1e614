"""Checks of a dataset's content: rows and trials that are left out, misspelt names,
noise, number of strings.
"""

from __future__ import annotations

import difflib
import shlex
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from stringcast.data.artifacts import ARM, GRASP, POINTS
from stringcast.data.dataset import exclude_stray_points, with_trial
from stringcast.data.metadata import (
    DATASET_FILE,
    ArmBlock,
    Block,
    CameraBlock,
    Metadata,
    NoiseBlock,
    StringBlock,
    TrialBlock,
)
from stringcast.stages.check.finding import Finding, Severity
from stringcast.stages.check.measured import LOST_SHARE, CheckedDataset
from stringcast.stages.check.mistakes import impossible_views, unknown_arm_fields

MAX_LOST_SHARE = 0.1  # of the rows: if so many cannot be used, something is wrong
NAME_SIMILARITY = 0.75  # likeness of names
# times the noise that is stated, and a fraction of it
NOISE_RATIO_HIGH, NOISE_RATIO_LOW = 5.0, 3.0
COARSE_NOISE_SHARE = 0.1  # of the length: no point is measured so badly
LENGTH_RATIO = 1.1  # times as long is another string
MAX_FRAME_RATE = 1e7  # [1/s]: no camera films faster
MIN_LENGTH_SHARE = 0.5  # of the length: if nothing is seen beyond, the tip was not
GEOMETRY = {"links": "how long its links are", "base": "where its joint 1 sits"}
BLOCKS: Mapping[str, type[Block]] = {
    "string": StringBlock,
    "noise": NoiseBlock,
    "arm": ArmBlock,
    "camera": CameraBlock,
}


def check_rows(measured: CheckedDataset) -> Iterator[Finding]:
    """Rows that cannot be used, or were not in order."""
    known = {
        column.name
        for table in (ARM, GRASP, POINTS)
        for column in with_trial(table).columns
    }
    for file, what in measured.data.row_counts.items():
        if what.dropped:
            lost = sum(what.dropped.values())
            reasons = "; ".join(
                f"{count}: {reason}" for reason, count in what.dropped.items()
            )
            said = f"{lost} of {what.total} rows are left out ({reasons})"
            severity = (
                Severity.WARNING
                if lost > MAX_LOST_SHARE * what.total
                else Severity.NOTE
            )
            if lost > LOST_SHARE * what.total:
                severity, said = (
                    Severity.ERROR,
                    f"{said}: too few are left to tell anything",
                )
            # of columns
            spoken = (
                word
                for reason in what.dropped
                for word in reason.split()[:2]
                if word in known
            )
            field = ", ".join(dict.fromkeys(spoken))
            yield Finding(
                severity, file, field, said, "Correct them if they should count"
            )
        if what.unordered:
            said = f"{what.unordered} rows are earlier than the row before them"
            yield Finding(
                Severity.NOTE,
                file,
                "t",
                said,
                "They are put in order; see that each trial was one recording",
            )


def check_empty_tables(measured: CheckedDataset) -> Iterator[Finding]:
    """Tables without a row."""
    for file, what in measured.data.row_counts.items():
        if not what.total:
            yield Finding(
                Severity.ERROR, file, "trial", "it holds no rows", "Fill it in"
            )


def check_rejected_trials(measured: CheckedDataset) -> Iterator[Finding]:
    """Trials that cannot be used: an error where no other is left."""
    kept, contradictory = (
        exclude_stray_points(measured.data, measured.length),
        impossible_views(measured),
    )
    severity = Severity.WARNING if kept.trials else Severity.ERROR
    for name, fault in kept.unusable.items():
        if name not in contradictory:  # of which `mistakes` says more
            said = f"the trial is left out: {fault.reason}"
            yield Finding(
                severity,
                measured.file(fault.file),
                fault.field,
                said,
                fault.remedy,
                (name,),
            )


def check_duplicate_tables(measured: CheckedDataset) -> Iterator[Finding]:
    """Tables that are there as Parquet and as CSV: one of them is not looked at."""
    for file in measured.data.row_counts:
        other = Path(file).with_suffix(".csv").name
        if file != other and (measured.data.folder / other).exists():
            yield Finding(
                Severity.WARNING,
                file,
                "",
                f"it is read, and {other} is not",
                "Remove the one that is old",
            )


def check_trial_count(measured: CheckedDataset) -> Iterator[Finding]:
    """Too few trials to confirm anything."""
    if len(measured.trials) == 1:
        said = "one trial can be used: a cause found in it could not be confirmed on another"
        yield Finding(
            Severity.WARNING,
            measured.hand_file,
            "trial",
            said,
            "Record two more",
            (measured.trials[0].name,),
        )


def check_string_length(measured: CheckedDataset) -> Iterator[Finding]:
    """A string whose length is not said, does not reach its points, or that is several
    strings.
    """
    if "length" not in (measured.data.metadata.get("string") or {}):
        said = f"it is missing; {measured.length:.3f} m is assumed"
        yield Finding(
            Severity.WARNING,
            DATASET_FILE,
            "string.length",
            said,
            "Write string: {length: <metres, grasp to tip>}",
        )
    ends = {seen.name: float(seen.points["s"].max()) for seen in measured.with_points()}
    if ends and max(ends.values()) > LENGTH_RATIO * min(ends.values()):
        said = f"the largest s is {min(ends.values()):.3g} m in one trial and {max(ends.values()):.3g} m in another"
        remedy = "A folder is one string: make a folder of each, or correct s"
        yield Finding(Severity.WARNING, measured.file("points"), "s", said, remedy)
    elif (
        ends
        and MIN_LENGTH_SHARE * measured.length
        > max(ends.values())
        > 0.01 * measured.length
    ):
        said = f"points go to {max(ends.values()):.3g} m of a string of {measured.length:.3g} m: its tip was not seen"
        yield Finding(
            Severity.WARNING,
            measured.file("points"),
            "s",
            said,
            "Correct s or string.length, if that is wrong",
        )


def check_arm(measured: CheckedDataset) -> Iterator[Finding]:
    """Joint angles of an arm of which nobody says how long its links are, or where it
    stands.
    """
    missing = unknown_arm_fields(measured)
    if not missing:
        return
    configured = {key: f"{key}: {list(getattr(measured.arm, key))}" for key in missing}
    lacking = " and ".join(GEOMETRY[key] for key in missing)
    held = (
        "not be held where its hand would be"
        if impossible_views(measured)
        else "be held, as it could by another"
    )
    said = (
        f"{measured.hand_file} holds joint angles of an arm, and nothing says {lacking}; of the configured arm "
        f"({', '.join(configured.values())}, in metres) this string could {held}"
    )
    if measured.data.metadata.get("arm"):
        remedy = "Write beside it what your arm has, in metres, as the configured one "
        remedy += " and ".join(configured.values())
    else:
        block = f"\\narm: {{{', '.join(configured.values())}}}\\n"
        file = shlex.quote(str(measured.data.folder / DATASET_FILE))
        remedy = f"Write what your arm has; if it is the configured one: printf '{block}' >> {file}"
    yield Finding(
        Severity.ERROR,
        DATASET_FILE,
        ", ".join(f"arm.{key}" for key in missing),
        said,
        remedy,
    )


def check_hand_tables(measured: CheckedDataset) -> Iterator[Finding]:
    """Joint angles and poses of the hand, of which one is not looked at."""
    there = [
        file
        for file in measured.data.hashes
        if file.rpartition(".")[0] in (ARM.name, GRASP.name)
    ]
    if len(there) > 1:
        said = f"{' and '.join(there)} both say how the hand moved"
        remedy = f"Keep the one that is right, and take the other away: rm {measured.data.folder / there[-1]}"
        yield Finding(
            Severity.ERROR, ", ".join(there), "q1, q2, q3, x, y, theta", said, remedy
        )


def check_camera(measured: CheckedDataset) -> Iterator[Finding]:
    """A frame rate that no camera has."""
    fps = (measured.data.metadata.get("camera") or {}).get("fps")
    if fps is not None and fps > MAX_FRAME_RATE:
        said = f"it is {float(fps):.3g} frames a second, more than any camera takes"
        yield Finding(
            Severity.WARNING,
            DATASET_FILE,
            "camera.fps",
            said,
            "Write how many it took in a second",
        )


def check_noise(measured: CheckedDataset) -> Iterator[Finding]:
    """Noise that is stated in another unit, or that points do not have."""
    for seen in measured.informative_trials():
        # as the dataset states it
        sigma = (
            float(np.median(seen.points["sigma"])) if "sigma" in seen.points else None
        )
        place = (
            (DATASET_FILE, "noise.point_sigma")
            if "noise" in measured.data.metadata
            else (measured.file("points"), "sigma")
        )
        if sigma is not None and sigma > COARSE_NOISE_SHARE * seen.length:
            said = f"noise is stated as {sigma:.3g} m on a string of {seen.length:.3g} m: millimetres, as it seems"
            yield Finding(
                Severity.ERROR, *place, said, "Multiply it by 0.001", (seen.name,)
            )
        elif (
            sigma is not None
            and seen.noise > 0
            and not 1 / NOISE_RATIO_LOW < seen.noise / sigma < NOISE_RATIO_HIGH
        ):
            said = f"noise is stated as {sigma:.2g} m, points show {seen.noise:.2g} m from frame to frame"
            yield Finding(
                Severity.WARNING,
                *place,
                said,
                "Correct it, or leave it out: then it is estimated",
                (seen.name,),
            )


def check_names(measured: CheckedDataset) -> Iterator[Finding]:
    """Keys and columns that are unknown, but nearly known: they count for nothing."""
    about = measured.data.metadata
    yield from _similar_names(about, Metadata.model_fields, "")
    for block, kind in BLOCKS.items():
        yield from _similar_names(
            about.get(block) or {}, kind.model_fields, f"{block}."
        )
    for trial, own in about.get("trials", {}).items():
        yield from _similar_names(own, TrialBlock.model_fields, f"trials.{trial}.")
    for seen in measured.trials[:1]:
        for table, frame in (
            (POINTS, seen.points),
            (GRASP if seen.joints is None else ARM, seen.motion),
        ):
            known = [column.name for column in table.columns if len(column.name) > 2]
            yield from _similar_names(
                dict.fromkeys(frame.columns), known, "", measured.file(table.name)
            )


def _similar_names(
    given: Mapping[Any, Any], known: Any, place: str, file: str = DATASET_FILE
) -> Iterator[Finding]:
    """Unknown names that look like known ones that are not given."""
    for name in map(str, given):
        near = difflib.get_close_matches(
            name.strip().lower(),
            [k for k in known if k not in given],
            1,
            NAME_SIMILARITY,
        )
        if near and name not in known:
            said = f"there is no such name, it is ignored; '{near[0]}' is one"
            yield Finding(
                Severity.WARNING,
                file,
                f"{place}{name}",
                said,
                f"Call it '{near[0]}', if it is that",
            )


def check_roles(measured: CheckedDataset) -> Iterator[Finding]:
    """Trials that dataset.yaml speaks of and that are not there; trials all held out."""
    spoken = measured.data.metadata.get("trials", {})
    there = {seen.name for seen in measured.trials}
    for name in sorted(set(spoken) - there - set(measured.data.rejection_reasons)):
        yield Finding(
            Severity.WARNING,
            DATASET_FILE,
            f"trials.{name}",
            "there is no such trial",
            "Correct the name",
        )
    for name, own in spoken.items():
        if own.get("role") not in (None, "held_out"):
            said = (
                f"{own['role']!r} is no role, and counts for nothing; 'held_out' is one"
            )
            yield Finding(
                Severity.WARNING,
                DATASET_FILE,
                f"trials.{name}.role",
                said,
                "Write held_out, or leave it out",
            )
    held_out = {name for name, own in spoken.items() if own.get("role") == "held_out"}
    if there and there <= held_out:
        said = "all trials are held out: none is left to learn from, and so none is held out"
        yield Finding(
            Severity.WARNING,
            DATASET_FILE,
            "trials",
            said,
            "Take the role from some of them",
        )
