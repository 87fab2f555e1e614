"""Estimate of the string's length from the string at rest and its motion."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from stringcast.data.metadata import DATASET_FILE
from stringcast.stages.check.consistency.corrections.base import Correction
from stringcast.stages.check.consistency.judge import hanging_lengths, judge
from stringcast.stages.check.consistency.record import Measurements

FINE_RATIOS = np.arange(0.96, 1.045, 0.01)  # around the best coarse length
# relative difference from the stated length: stiffness shifts the best length by less
MIN_LENGTH_ERROR = 0.08


@dataclass(frozen=True, kw_only=True)
class WrongLength(Correction):
    """The string has another length than the stated one."""

    table = DATASET_FILE
    field = "string.length"
    statement: str
    remedy = "Measure it from the grasp to the tip"
    length: float

    def undo(self, measured: Measurements) -> Measurements | None:
        """Return the measurements with the fitted length."""
        return replace(measured, length=self.length)


def length_corrections(measured: Measurements) -> Iterator[tuple[Correction, ...]]:
    """Yield the fitted length, if it differs from the stated one.

    With stated arc lengths, the points at rest tell the length: see `rest_shape`.
    """
    stated = measured.length
    if stated is None or measured.stated_arc_lengths:
        return
    misfits = misfits_of_lengths(measured, hanging_lengths(measured))
    if not misfits:
        return
    coarse = min(misfits, key=misfits.__getitem__)
    misfits |= misfits_of_lengths(measured, coarse * FINE_RATIOS)
    best = min(misfits, key=misfits.__getitem__)
    length = round(best, 3)
    if abs(length - stated) > MIN_LENGTH_ERROR * stated:
        statement = f"the string's motion fits a length of about {length:.3g} m"
        yield (WrongLength(statement=statement, length=length),)


def misfits_of_lengths(
    measured: Measurements, lengths: Iterable[float]
) -> dict[float, float]:
    """Return the misfit [m] of each possible length [m]."""
    misfits = {}
    for length in lengths:
        verdict = judge(replace(measured, length=float(length)))
        if verdict.is_consistent and verdict.misfits:
            misfits[float(length)] = verdict.misfit_m
    return misfits
