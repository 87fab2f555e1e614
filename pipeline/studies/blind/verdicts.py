"""The answer of a diagnosis, and whether it is right: one bench at a time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

RESOLUTION, NONE, UNKNOWN = "resolution", "none", "unknown"
SEVERAL = ("pair", "triple")
RESOLVED = 5.0  # sigmas
Row = Mapping[str, Any]
Answer = frozenset[str]


def answers(row: Row) -> list[Answer]:
    """Causes in the order named, each as the group of those it cannot be told from;
    without what is true anyway.
    """
    diagnosis, alike = row["diagnosis"], row["truth"].get("alike", {})
    groups = [
        frozenset(alike.get(n, n) for n in group)
        for group in diagnosis.get("indistinguishable") or []
    ]
    found: list[Answer] = []
    for cause in diagnosis.get("causes") or []:
        name = alike.get(cause["effect"], cause["effect"])
        answer = next((group for group in groups if name in group), frozenset({name}))
        if answer not in found and not (answer == {RESOLUTION} and _true_anyway(row)):
            found.append(answer)
    return found


def _true_anyway(row: Row) -> bool:
    """Too few points, on a bench that hides something else or nothing."""
    return (
        row["truth"]["kind"] != RESOLUTION
        and row["truth"].get("paper", RESOLVED) >= RESOLVED
    )


def correct(row: Row) -> bool:
    """The answer is right, as the module says."""
    kind, names = row["truth"]["kind"], row["truth"]["names"]
    verdict, said = row["diagnosis"]["verdict"], answers(row)
    if kind == "outside":
        return bool(verdict == UNKNOWN and not said)
    if kind == NONE:
        return not said and verdict in (NONE, "effect")
    if verdict not in ("effect", "ambiguous"):
        return False
    if kind in SEVERAL:
        return found_of_several(row) == len(names)
    return bool(said) and names[0] in said[0]


def found_of_several(row: Row) -> int:
    """The number of hidden causes that are named, each in a group of its own."""
    names, said = row["truth"]["names"], answers(row)
    places = {
        name: [i for i, group in enumerate(said) if name in group] for name in names
    }
    return min(
        sum(bool(place) for place in places.values()),
        len({i for place in places.values() for i in place}),
    )


def answered(row: Row) -> str:
    """The answer in a word: the true cause if it is in the first group, else the first
    named, else the verdict.
    """
    said, verdict = answers(row), str(row["diagnosis"]["verdict"])
    if not said:
        return NONE if verdict == "effect" else verdict
    true = [name for name in row["truth"]["names"] if name in said[0]]
    first = [c["effect"] for c in row["diagnosis"]["causes"] if c["effect"] in said[0]]
    return str((true or first)[0])


def beliefs(row: Row) -> dict[str, float]:
    """Probabilities by name; what is missing to one goes to `none` or `unknown` if that
    is the verdict.
    """
    diagnosis, alike = row["diagnosis"], row["truth"].get("alike", {})
    stated = [*(diagnosis.get("causes") or []), *(diagnosis.get("alternatives") or [])]
    known = {
        alike.get(one["effect"], one["effect"]): float(one["probability"])
        for one in reversed(stated)
    }
    verdict = diagnosis["verdict"]
    if verdict in (NONE, UNKNOWN):
        known.setdefault(verdict, max(1.0 - sum(known.values()), 0.0))
    return known


def confidence(row: Row) -> float:
    """Probability of the answer: all that is named together, for causes that are needed
    together share what their set has; or that of the verdict. NaN if there is none.
    """
    known, said = beliefs(row), answers(row)
    if said:
        return min(sum(known.get(name, 0.0) for name in frozenset().union(*said)), 1.0)
    verdict = row["diagnosis"]["verdict"]
    return known.get(RESOLUTION if verdict == "effect" else verdict, float("nan"))


def named_above(row: Row, probability: float) -> bool:
    """A library effect has more than this probability."""
    besides = {NONE, UNKNOWN} | ({RESOLUTION} if _true_anyway(row) else set())
    return any(
        p > probability for name, p in beliefs(row).items() if name not in besides
    )
