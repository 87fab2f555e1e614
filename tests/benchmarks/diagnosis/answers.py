"""The answer of a diagnosis to one synthetic dataset, and whether it is right."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from stringcast.stages.diagnose.trials.outlying_trials import OUTLYING
from stringcast.stages.diagnose.verdict import RESOLUTION

NONE, EFFECT, UNKNOWN, PARTIAL = "none", "effect", "unknown", "partial"
MIXED = "mixed"
SEVERAL = ("pair", "triple")
Row = Mapping[str, Any]
CauseGroup = frozenset[str]  # look-alikes that the data cannot distinguish


def named_groups(row: Row) -> list[CauseGroup]:
    """Return the named causes in order, each as the group of its look-alikes.

    That the diagnosed mesh is too coarse is none of them: no simulator hides it, and it
    is so wherever ten mass points stand for a continuous string.
    """
    diagnosis, synonyms = row["diagnosis"], row["truth"].get("alike", {})
    look_alikes = []
    for group in diagnosis.get("indistinguishable") or []:
        look_alikes.append(frozenset(synonyms.get(name, name) for name in group))
    groups: list[CauseGroup] = []
    for cause in diagnosis.get("causes") or []:
        if cause["effect"] == RESOLUTION:
            continue
        name = synonyms.get(cause["effect"], cause["effect"])
        group = next(
            (group for group in look_alikes if name in group), frozenset({name})
        )
        if group not in groups:
            groups.append(group)
    return groups


def is_correct(row: Row) -> bool:
    """Return whether the answer is right.

    - nothing hidden: no cause is named;
    - one cause hidden: it is in the first group that is named;
    - several hidden: each is named, in a group of its own;
    - a cause outside the library: nothing is named, and a remainder is reported;
    - both: a cause of the library is named, no false one, and a remainder is reported.
    """
    kind, names = row["truth"]["kind"], row["truth"]["names"]
    verdict, groups = row["diagnosis"]["verdict"], named_groups(row)
    if kind == "outside":
        return reports_remainder(row) and not groups
    if kind == MIXED:
        is_false = count_false(row) > 0
        return count_found(row) > 0 and not is_false and reports_remainder(row)
    if kind == NONE:
        return not groups and verdict in (NONE, EFFECT)
    if verdict not in (EFFECT, "ambiguous", PARTIAL):
        return False
    if kind in SEVERAL:
        return count_found(row) == len(names)
    return bool(groups) and names[0] in groups[0]


def count_found(row: Row) -> int:
    """Count hidden causes that are named, each in a group of its own."""
    groups = named_groups(row)
    found, used = 0, set()
    for name in row["truth"]["names"]:
        containing = [i for i, group in enumerate(groups) if name in group]
        found += bool(containing)
        used.update(containing)
    return min(found, len(used))


def count_false(row: Row) -> int:
    """Count named groups without a hidden cause or a small error that is there."""
    truth = row["truth"]
    right = {*truth["names"], *truth.get("tolerated", ())}
    return sum(not group & right for group in named_groups(row))


def reports_remainder(row: Row) -> bool:
    """Return whether the answer says that a part of the misfit is not explained.

    It may be that of one trial, which is then excluded.
    """
    diagnosis = row["diagnosis"]
    reasons = diagnosis.get("trials", {}).get("rejected", {}).values()
    is_outlying = any(reason.startswith(OUTLYING) for reason in reasons)
    return diagnosis["verdict"] in (PARTIAL, UNKNOWN) or is_outlying


def answer_name(row: Row) -> str:
    """Return the answer in a word.

    It is the true cause if that is in the first group, else the first named cause or
    the verdict.
    """
    groups, verdict = named_groups(row), str(row["diagnosis"]["verdict"])
    if not groups:
        return verdict
    true = [name for name in row["truth"]["names"] if name in groups[0]]
    named = [
        cause["effect"]
        for cause in row["diagnosis"]["causes"]
        if cause["effect"] in groups[0]
    ]
    return str((true or named)[0])


def cause_probabilities(row: Row) -> dict[str, float]:
    """Return probabilities by cause.

    The remainder to one goes to the verdict `none` or `unknown`.
    """
    diagnosis, synonyms = row["diagnosis"], row["truth"].get("alike", {})
    probabilities = {}
    for cause in reversed(
        [*(diagnosis.get("causes") or []), *(diagnosis.get("alternatives") or [])]
    ):
        probabilities[synonyms.get(cause["effect"], cause["effect"])] = float(
            cause["probability"]
        )
    verdict = diagnosis["verdict"]
    if verdict in (NONE, UNKNOWN):
        probabilities.setdefault(verdict, max(1.0 - sum(probabilities.values()), 0.0))
    return probabilities


def answer_probability(row: Row) -> float:
    """Return the probability of the answer, NaN if none is stated.

    Causes that are needed together share the probability of their set, so that those of
    all named causes add up.
    """
    probabilities, groups = cause_probabilities(row), named_groups(row)
    if groups:
        named = frozenset().union(*groups)
        return min(sum(probabilities.get(name, 0.0) for name in named), 1.0)
    return probabilities.get(row["diagnosis"]["verdict"], float("nan"))


def is_named_above(row: Row, probability: float) -> bool:
    """Return whether a library effect has more than this probability."""
    return any(
        p > probability
        for name, p in cause_probabilities(row).items()
        if name not in (NONE, UNKNOWN)
    )
