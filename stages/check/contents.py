"""Checks of contents: unusable rows and trials, names, noise, length, arm."""

from __future__ import annotations

import difflib
import shlex
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np

from stringcast.data.artifacts import ARM, GRASP, POINTS
from stringcast.data.dataset import exclude_stray_points
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
from stringcast.data.rows import RowCounts
from stringcast.stages.check.consistency.check import (
    impossible_trials,
    unknown_arm_fields,
)
from stringcast.stages.check.finding import Finding, error, note, warning
from stringcast.stages.check.measured import (
    MAX_LOST_SHARE,
    SUSPICIOUS_LOST_SHARE,
    CheckedDataset,
)

MIN_NAME_SIMILARITY = 0.75
# factors by which measured noise may be larger and smaller than stated noise
NOISE_RATIO_HIGH, NOISE_RATIO_LOW = 5.0, 3.0
MAX_NOISE = 0.1  # relative to the string's length
MAX_LENGTH_RATIO = 1.1  # between trials with the same string
MIN_SEEN_LENGTH = 0.5  # share of the string: if less is seen, the tip is not
MIN_METRIC_LENGTH = 0.01  # share of the string: if less is seen, the unit is wrong
GEOMETRY = {"links": "how long its links are", "base": "where its joint 1 sits"}
BLOCKS: Mapping[str, type[Block]] = {
    "string": StringBlock,
    "noise": NoiseBlock,
    "arm": ArmBlock,
    "camera": CameraBlock,
}


def check_rows(dataset: CheckedDataset) -> Iterator[Finding]:
    """Find rows that cannot be used or are not in order."""
    for file, rows in dataset.data.row_counts.items():
        if rows.dropped:
            yield _dropped_rows(file, rows)
        if rows.unordered:
            statement = f"{rows.unordered} rows are earlier than the row before them"
            remedy = "They are put in order; see that each trial was one recording"
            yield note(file, "t", statement, remedy)


def _dropped_rows(file: str, rows: RowCounts) -> Finding:
    """Describe rows that are left out."""
    lost = sum(rows.dropped.values())
    reasons = [f"{count}: {reason}" for reason, count in rows.dropped.items()]
    statement = f"{lost} of {rows.total} rows are left out ({'; '.join(reasons)})"
    report = warning if lost > SUSPICIOUS_LOST_SHARE * rows.total else note
    if lost > MAX_LOST_SHARE * rows.total:
        report = error
        statement = f"{statement}: too few are left to show anything"

    remedy = "Correct them if they should count"
    return report(file, ", ".join(rows.columns), statement, remedy)


def check_empty_tables(dataset: CheckedDataset) -> Iterator[Finding]:
    """Find tables without a row."""
    for file, rows in dataset.data.row_counts.items():
        if not rows.total:
            yield error(file, "trial", "it has no rows", "Fill it in")


def check_rejected_trials(dataset: CheckedDataset) -> Iterator[Finding]:
    """Find trials that cannot be used: an error if no other is left."""
    kept = exclude_stray_points(dataset.data, dataset.length)
    contradictory = impossible_trials(dataset)  # another check reports these
    report = warning if kept.trials else error
    for name, fault in kept.unusable.items():
        if name not in contradictory:
            file = dataset.file(fault.file)
            statement = f"the trial is left out: {fault.reason}"
            yield report(file, fault.field, statement, fault.remedy, name)


def check_duplicate_tables(dataset: CheckedDataset) -> Iterator[Finding]:
    """Find tables that exist as Parquet and as CSV, of which only one is read."""
    for file in dataset.data.row_counts:
        other = Path(file).with_suffix(".csv").name
        if file != other and (dataset.data.folder / other).exists():
            statement = f"it is read, and {other} is not"
            yield warning(file, "", statement, "Remove the one that is old")


def check_trial_count(dataset: CheckedDataset) -> Iterator[Finding]:
    """Find datasets with too few trials to confirm anything."""
    if len(dataset.trials) == 1:
        name = dataset.trials[0].name
        statement = (
            "one trial can be used: a cause found in it could not be confirmed on "
            "another"
        )
        yield warning(dataset.hand_file, "trial", statement, "Record two more", name)


def check_string_length(dataset: CheckedDataset) -> Iterator[Finding]:
    """Find a missing or wrong length, and several strings."""
    length = dataset.length
    if "length" not in dataset.metadata_block("string"):
        statement = f"it is missing; {length:.3f} m is assumed"
        remedy = "Write string: {length: <metres, grasp to tip>}"
        yield warning(DATASET_FILE, "string.length", statement, remedy)
    ends = [float(trial.points["s"].max()) for trial in dataset.with_points()]
    if not ends:
        return
    shortest, longest = min(ends), max(ends)
    if longest > MAX_LENGTH_RATIO * shortest:
        statement = (
            f"the largest s is {shortest:.3g} m in one trial and {longest:.3g} m in "
            "another"
        )
        remedy = "A folder is one string: make a folder of each, or correct s"
        yield warning(dataset.points_file, "s", statement, remedy)
    elif MIN_SEEN_LENGTH * length > longest > MIN_METRIC_LENGTH * length:
        statement = (
            f"points go to {longest:.3g} m of a string of {length:.3g} m: its tip was "
            "not seen"
        )
        remedy = "Correct s or string.length, if that is wrong"
        yield warning(dataset.points_file, "s", statement, remedy)


def check_arm(dataset: CheckedDataset) -> Iterator[Finding]:
    """Find joint angles without the arm's links or base."""
    missing = unknown_arm_fields(dataset)
    if not missing:
        return
    unknown = " and ".join(GEOMETRY[key] for key in missing)
    values = [f"{key}: {list(getattr(dataset.arm, key))}" for key in missing]
    configured = ", ".join(values)
    if impossible_trials(dataset):
        verdict = "this string could not be where its hand would be"
    else:
        verdict = "this string is possible, but other arms are, too"
    statement = (
        f"{dataset.hand_file} has joint angles of an arm, but it is not stated "
        f"{unknown}; with the configured arm ({configured}, in metres) {verdict}"
    )
    if dataset.data.metadata.get("arm"):
        remedy = "Add what your arm has, in metres, as the configured one has "
        remedy += " and ".join(values)
    else:
        file = shlex.quote(str(dataset.data.folder / DATASET_FILE))
        remedy = (
            "Write what your arm has; if it is the configured one: "
            f"printf '\\narm: {{{configured}}}\\n' >> {file}"
        )
    fields = ", ".join(f"arm.{key}" for key in missing)
    yield error(DATASET_FILE, fields, statement, remedy)


def check_hand_tables(dataset: CheckedDataset) -> Iterator[Finding]:
    """Find joint angles together with poses of the hand, only one of which is used."""
    tables = (ARM.name, GRASP.name)
    files = [file for file in dataset.data.hashes if file.rpartition(".")[0] in tables]
    if len(files) > 1:
        statement = f"{' and '.join(files)} both say how the hand moved"
        remedy = (
            "Keep the one that is right, and take the other away: "
            f"rm {dataset.data.folder / files[-1]}"
        )
        yield error(", ".join(files), "q1, q2, q3, x, y, theta", statement, remedy)


def check_noise(dataset: CheckedDataset) -> Iterator[Finding]:
    """Find stated noise in a wrong unit or too small, and smoothed tracks."""
    if "noise" in dataset.data.metadata:
        place = (DATASET_FILE, "noise.point_sigma")
    else:
        place = (dataset.points_file, "sigma")
    for trial in dataset.informative_trials():
        scatter = f"{trial.noise:.2g} m from frame to frame"
        if "sigma" not in trial.points:
            if trial.is_smoothed:
                statement = (
                    f"points at rest scatter by {scatter}, and more over longer times: "
                    "the track seems smoothed, and its noise is larger"
                )
                remedy = "State it: noise: {point_sigma: <metres>}"
                yield note(*place, statement, remedy, trial.name)
            continue
        sigma = float(np.median(trial.points["sigma"]))
        if sigma > MAX_NOISE * trial.length:
            statement = (
                f"noise is stated as {sigma:.3g} m on a string of {trial.length:.3g} m:"
                " it seems to be in millimetres"
            )
            yield error(*place, statement, "Multiply it by 0.001", trial.name)
        elif trial.noise >= NOISE_RATIO_HIGH * sigma:
            statement = f"noise is stated as {sigma:.2g} m, points show {scatter}"
            remedy = "Correct it, or leave it out: then it is estimated"
            yield warning(*place, statement, remedy, trial.name)
        elif 0 < trial.noise * NOISE_RATIO_LOW <= sigma:
            why = ": the track seems smoothed" if trial.is_smoothed else ""
            statement = (
                f"noise is stated as {sigma:.2g} m, points show {scatter}, which is a "
                f"lower bound{why}; the stated noise is kept"
            )
            remedy = "Nothing needs to be done, if points may be off by that much"
            yield note(*place, statement, remedy, trial.name)


def check_names(dataset: CheckedDataset) -> Iterator[Finding]:
    """Find misspelt keys and columns, which are ignored."""
    metadata = dataset.data.metadata
    yield from _similar_names(metadata, Metadata.model_fields)
    for block, kind in BLOCKS.items():
        keys = dataset.metadata_block(block)
        yield from _similar_names(keys, kind.model_fields, f"{block}.")
    for name, keys in metadata.get("trials", {}).items():
        yield from _similar_names(keys, TrialBlock.model_fields, f"trials.{name}.")
    for trial in dataset.trials[:1]:
        hand = GRASP if trial.joints is None else ARM
        for table, frame in ((POINTS, trial.points), (hand, trial.motion)):
            known = [column.name for column in table.columns if len(column.name) > 2]
            file = dataset.file(table.name)
            yield from _similar_names(list(frame.columns), known, file=file)


def _similar_names(
    names: Collection[object],
    known: Iterable[str],
    prefix: str = "",
    file: str = DATASET_FILE,
) -> Iterator[Finding]:
    """Find unknown names that look like known ones that are missing."""
    known = list(known)
    missing = [name for name in known if name not in names]
    for name in map(str, names):
        word = name.strip().lower()
        matches = difflib.get_close_matches(word, missing, 1, MIN_NAME_SIMILARITY)
        if matches and name not in known:
            statement = f"there is no such name, it is ignored; '{matches[0]}' is one"
            remedy = f"Call it '{matches[0]}', if it is that"
            yield warning(file, f"{prefix}{name}", statement, remedy)


def check_roles(dataset: CheckedDataset) -> Iterator[Finding]:
    """Find metadata of missing trials, unknown roles, and held-out datasets."""
    described = dataset.data.metadata.get("trials", {})
    trials = {trial.name for trial in dataset.trials}
    for name in sorted(
        described.keys() - trials - dataset.data.rejection_reasons.keys()
    ):
        statement = "there is no such trial"
        yield warning(DATASET_FILE, f"trials.{name}", statement, "Correct the name")
    held_out = set()
    for name, block in described.items():
        role = block.get("role")
        if role == "held_out":
            held_out.add(name)
        elif role is not None:
            statement = f"{role!r} is no role and is ignored; 'held_out' is one"
            remedy = "Write held_out, or leave it out"
            yield warning(DATASET_FILE, f"trials.{name}.role", statement, remedy)
    if trials and trials <= held_out:
        statement = (
            "all trials are held out: none is left to learn from, and so none is held "
            "out"
        )
        remedy = "Take the role from some of them"
        yield warning(DATASET_FILE, "trials", statement, remedy)
