"""Checks whether hand, string and stated geometry are consistent."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache

import numpy as np

from stringcast.data.dataset import exclude_stray_points
from stringcast.stages.check.consistency.corrections.base import Correction
from stringcast.stages.check.consistency.dataset import judge_dataset, measurements_of
from stringcast.stages.check.consistency.judge import Verdict, reason_beside_geometry
from stringcast.stages.check.consistency.limits import BrokenLimit, Limit
from stringcast.stages.check.consistency.search import Answer, Proposal, find_answer
from stringcast.stages.check.finding import Finding, error, warning
from stringcast.stages.check.measured import CheckedDataset

MAX_JOINT_ANGLE_RAD = 4 * np.pi
MAX_HAND_ANGLE_RAD = 12 * np.pi
ANGLE_QUANTILE = 0.9  # of the samples: others may be outliers
REMEDIES = {
    Limit.LENGTH: "Look at the units of s, x, y and string.length: all are metres",
    Limit.SPEED: "Look at the units of joint angles [rad], positions [m] and times [s]",
    Limit.ARC_LENGTH: "Correct string.length in dataset.yaml, or s",
    Limit.STRETCH: "Look at the units of s, x, y and string.length: all are metres",
    Limit.ORDER: "Look at the names of the points, and at the directions of x and y",
    Limit.GAP: (
        "Give points and hand in one frame of reference: see arm.base and "
        "camera.origin_px in dataset.yaml, and whether the angles count from +x, "
        "counter-clockwise"
    ),
}
LOOK_AT_GEOMETRY = (
    "Look at arm.links, arm.base, string.length, the order and signs of the joints, "
    "the directions of x and y, and which points belong to which trial"
)
STATE_GEOMETRY = (
    "If all of that was measured, state 'geometry: measured' in dataset.yaml, or "
    "import with --geometry-measured"
)


def check_consistency(dataset: CheckedDataset) -> Iterator[Finding]:
    """Find data that no string can show, and corrections that make them consistent."""
    if unknown_arm_fields(dataset):
        return
    verdict = judge_dataset(dataset)
    answer = dataset_answer(dataset)
    if answer.pairing:
        yield pairing_finding(dataset, answer.pairing)
        return
    names = tuple(verdict.broken or verdict.misfits)
    if answer.proposals:
        yield from proposal_findings(dataset, verdict, answer.proposals, names)
    elif verdict.is_consistent:
        return
    elif verdict.broken:
        for name, broken in verdict.broken.items():
            yield unexplained_finding(dataset, name, broken)
    else:
        yield misfit_finding(dataset, verdict, names)


@lru_cache(maxsize=4)
def dataset_answer(dataset: CheckedDataset) -> Answer:
    """Return the corrections that make a dataset consistent; computed once.

    There are none if links or base of the arm are not stated.
    """
    if unknown_arm_fields(dataset):
        return Answer()
    measured, verdict = measurements_of(dataset), judge_dataset(dataset)
    return find_answer(measured, verdict, dataset.camera)


def impossible_trials(dataset: CheckedDataset) -> dict[str, BrokenLimit]:
    """Return the limit that each impossible trial breaks, by trial."""
    return dict(judge_dataset(dataset).broken)


def proposal_findings(
    dataset: CheckedDataset,
    verdict: Verdict,
    proposals: Sequence[Proposal],
    names: Sequence[str],
) -> Iterator[Finding]:
    """Yield an error for each correction of the best proposal."""
    best = proposals[0]
    alternative = ""
    if len(proposals) > 1:
        others = [describe_corrections(p.corrections) for p in proposals[1:]]
        alternative = f"; as well it may be that {' or that '.join(others)}"
    statement = (
        f"{describe_contradiction(verdict)}; corrected, {describe_fit(best.verdict)}"
        f"{alternative}"
    )
    for correction in best.corrections:
        file = correction.table
        if "." not in file:
            file = dataset.file(file)
        text = f"{correction.statement} as it seems: {statement}"
        yield error(file, correction.field, text, correction.remedy, *names)


def misfit_finding(
    dataset: CheckedDataset, verdict: Verdict, names: Sequence[str]
) -> Finding:
    """Return the finding of a misfit that no common mistake explains.

    It is an error unless the string may be bent or whip, or the geometry is stated to
    be measured.
    """
    statement, remedy = describe_misfit(verdict), LOOK_AT_GEOMETRY
    reason = reason_beside_geometry(verdict)
    if reason:
        statement += f"; {reason}"
        report = warning
    elif dataset.geometry_is_measured:
        report = warning
    else:
        remedy += f". {STATE_GEOMETRY}"
        report = error
    return report(dataset.points_file, "x, y", statement, remedy, *names)


def describe_corrections(corrections: Sequence[Correction]) -> str:
    """Return the corrected faults as a part of a sentence."""
    words = []
    for correction in corrections:
        place = f"{correction.table} {correction.field}"
        words.append(f"of {place}, {correction.statement}")
    return " and ".join(words)


def describe_contradiction(verdict: Verdict) -> str:
    """Return the broken limit or the misfit of the original data."""
    if verdict.broken:
        return next(iter(verdict.broken.values())).statement
    return describe_misfit(verdict)


def describe_misfit(verdict: Verdict) -> str:
    """Return the distance of points from the prediction, in words."""
    return (
        f"points are on average {verdict.misfit_m:.2g} m from where a straight string "
        "in this hand would be, at the best stiffness and clock offset"
    )


def describe_fit(verdict: Verdict) -> str:
    """Return the distance of corrected points from the prediction, in words."""
    if not verdict.misfits:
        return "the string is possible"
    return (
        f"points are {verdict.misfit_m:.2g} m from where a string in this hand would be"
    )


def pairing_finding(dataset: CheckedDataset, pairing: Mapping[str, str]) -> Finding:
    """Return the finding of points that belong to other trials."""
    pairs = [
        f"those of {points} fit the hand of {hand}" for hand, points in pairing.items()
    ]
    statement = f"it seems that points have changed trials: {', '.join(pairs)}"
    remedy = "Correct 'trial' of the points, or the names of the files they came from"
    return error(dataset.points_file, "trial", statement, remedy, *pairing)


def unexplained_finding(
    dataset: CheckedDataset, name: str, broken: BrokenLimit
) -> Finding:
    """Return the finding of an impossible string that no common mistake explains.

    If only its length is too small, the trial is left out of a run. That is an error if
    no other trial remains.
    """
    report, statement = error, broken.statement
    if broken.limit is Limit.ARC_LENGTH:
        if exclude_stray_points(dataset.data, dataset.length).trials:
            report = warning
        statement += ", and the trial is left out"
    remedy = REMEDIES[broken.limit]
    return report(dataset.points_file, "s, x, y", statement, remedy, name)


def unknown_arm_fields(dataset: CheckedDataset) -> list[str]:
    """Return the fields of the arm that are required but missing in dataset.yaml."""
    if all(trial.joints is None for trial in dataset.trials):
        return []
    block = dataset.metadata_block("arm")
    return [key for key in ("links", "base") if key not in block]


def check_angles(dataset: CheckedDataset) -> Iterator[Finding]:
    """Find angles that are too large for joints and hands in radians."""
    for trial in dataset.trials:
        if trial.joints is None:
            columns, limit = ["theta"], MAX_HAND_ANGLE_RAD
        else:
            columns, limit = ["q1", "q2", "q3"], MAX_JOINT_ANGLE_RAD
        largest = float(trial.motion[columns].abs().quantile(ANGLE_QUANTILE).max())
        if largest > limit:
            statement = (
                "angles seem to be in degrees, not in radians: they go up to "
                f"{largest:.4g}"
            )
            field, remedy = ", ".join(columns), "Multiply them by pi / 180"
            yield error(dataset.hand_file, field, statement, remedy, trial.name)
