"""Search for the corrections after which measurements are consistent."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product

import numpy as np

from stringcast.stages.check.consistency.arm_place import base_corrections
from stringcast.stages.check.consistency.corrections.base import (
    Correction,
    apply_corrections,
)
from stringcast.stages.check.consistency.corrections.catalogue import single_corrections
from stringcast.stages.check.consistency.corrections.directions import (
    DIRECTIONS,
    PointDirections,
)
from stringcast.stages.check.consistency.corrections.joints import (
    AbsoluteAngles,
    Degrees,
    joint_conventions,
)
from stringcast.stages.check.consistency.corrections.lengths import WrongUnit
from stringcast.stages.check.consistency.corrections.times import (
    PACES,
    RATES,
    Pace,
    PointRate,
    scale_all_times,
)
from stringcast.stages.check.consistency.judge import (
    MAX_MISFIT_RATIO,
    RIVAL_RATIO,
    Verdict,
    farthest_point,
    judge,
)
from stringcast.stages.check.consistency.limits import is_impossible
from stringcast.stages.check.consistency.pairing import find_pairing
from stringcast.stages.check.consistency.prediction import mean_motion
from stringcast.stages.check.consistency.record import Measurements
from stringcast.stages.check.consistency.string_length import length_corrections
from stringcast.stages.model.camera import Camera

# of strings that an arm can cast
MIN_CORRECTED_LENGTH_M, MAX_CORRECTED_LENGTH_M = 0.05, 2.0
# of a correction of rates, over the misfit before: in 15 right datasets of other
# simulators, half or double rates give a ratio of 1.2 to 20; in 14 others, rates wrong
# by a fifth give 1.15 to 4.8
MAX_RATE_RATIO = 0.6
# and over the motion of the points: with the right pace, it is 0.04 to 0.22 in six
# datasets; 1.0 with the wrong pace in a measured cable that rests bent
MAX_RATE_MISFIT = 0.5
WORST_PERFECT_MISFIT = 0.03  # below it, no mistake is searched
MAX_RIGHT_MISFIT = 0.06  # of a correction: above it, others are tried, too
RIVAL_MARGIN = 0.03  # corrections whose misfits differ by less fit equally well
MIN_SEEN_LENGTH = 0.3  # of the corrected string
MIN_MOTION = 0.01  # of points, in lengths: a lower limit in divisions


@dataclass(frozen=True)
class Proposal:
    """Corrections that make measurements consistent."""

    corrections: tuple[Correction, ...]
    verdict: Verdict


@dataclass(frozen=True)
class Answer:
    """The corrections, or the pairing, that make measurements consistent.

    proposals: the best first; more than one if the data do not decide. pairing: as in
    `find_pairing`.
    """

    proposals: Sequence[Proposal] = ()
    pairing: Mapping[str, str] = field(default_factory=dict)


def find_answer(
    measured: Measurements, before: Verdict, camera: Camera | None = None
) -> Answer:
    """Return corrections that make measurements consistent; empty if they are.

    Single corrections are tried first, then another pairing of trials, then another
    place of the arm or length, then pairs of corrections, then other signs and zeros of
    joints. The last three are also tried if a single correction has a larger misfit
    than right data: it may fit by chance.

    before: the verdict. camera: in whose pixels positions may be.
    """
    if before.is_consistent:
        return find_silent_mistake(measured, before)
    singles = single_corrections(measured, camera)
    alone = [(correction,) for correction in singles]
    proposals = consistent_proposals(measured, before, alone)
    if not proposals:
        pairing = find_pairing(measured, before)
        if pairing:
            return Answer(pairing=pairing)
    for candidates in (
        [*base_corrections(measured, ()), *length_corrections(measured)],
        pair_candidates(measured, singles),
    ):
        if not fits_as_right_data(proposals):
            others = consistent_proposals(measured, before, candidates)
            proposals = add_better_proposals(proposals, others)
    if not fits_as_right_data(proposals):
        # of so many, some fit by chance
        conventions = [(one,) for one in joint_conventions(measured)]
        others = consistent_proposals(measured, before, conventions)
        others = [one for one in others if one.verdict.misfit < MAX_RIGHT_MISFIT]
        proposals = add_better_proposals(proposals, others)
    return Answer(keep_rivals(proposals))


def fits_as_right_data(proposals: Sequence[Proposal]) -> bool:
    """Return whether the misfit of the best proposal is that of right data."""
    return bool(proposals) and proposals[0].verdict.misfit < MAX_RIGHT_MISFIT


def add_better_proposals(
    simpler: list[Proposal], others: list[Proposal]
) -> list[Proposal]:
    """Add other proposals that fit much better; return all, the best first.

    The others have more degrees of freedom and always fit a little better.
    """
    if not simpler:
        return others
    limit = MAX_MISFIT_RATIO * simpler[0].verdict.misfit
    better = [proposal for proposal in others if proposal.verdict.misfit < limit]
    return sorted([*better, *simpler], key=lambda proposal: proposal.verdict.misfit)


def find_silent_mistake(measured: Measurements, before: Verdict) -> Answer:
    """Return a mistake in consistent measurements that fit better without it.

    The string remains possible with a similar motion of another trial, a wrong rate, or
    a small error of the base or the length.
    """
    pairing = find_pairing(measured, before)
    if pairing or before.misfit < WORST_PERFECT_MISFIT:
        return Answer(pairing=pairing)
    candidates = [
        *((rate,) for rate in (*RATES, *PACES)),
        *base_corrections(measured, ()),
        *length_corrections(measured),
    ]
    proposals = consistent_proposals(measured, before, candidates)
    return Answer(keep_rivals(proposals))


def pair_candidates(
    measured: Measurements, singles: Iterable[Correction]
) -> Iterator[tuple[Correction, ...]]:
    """Yield pairs of corrections that occur in practice, and some triples."""
    singles = list(singles)
    units = [c for c in singles if isinstance(c, WrongUnit)]
    # with s in another unit, all points would lie at one place
    units = [c for c in units if "s" not in c.parts]
    point_directions = [c for c in singles if isinstance(c, PointDirections)]
    angles = [c for c in singles if isinstance(c, Degrees | AbsoluteAngles)]
    yield from product(units, [*point_directions, *angles])
    yield from product(DIRECTIONS, angles)
    points = [c for c in units if c.parts == ("xy",)]
    # of a tracker that states nothing, with the angles of another controller
    yield from product(points, point_directions, angles)
    for correction in (*DIRECTIONS, *points, *angles):
        yield from base_corrections(measured, (correction,))


def consistent_proposals(
    measured: Measurements,
    before: Verdict,
    candidates: Iterable[tuple[Correction, ...]],
) -> list[Proposal]:
    """Return the candidates that make measurements consistent."""
    proposals = []
    before_relative = relative_misfit(before)
    for corrections in candidates:
        corrected = apply_corrections(measured, corrections)
        if corrected is None or is_impossible(corrected):
            continue
        verdict = judge(corrected)
        length = verdict.measured.length or 0.0
        is_castable = MIN_CORRECTED_LENGTH_M < length < MAX_CORRECTED_LENGTH_M
        if not is_castable or is_seen_near_hand(corrected, length):
            continue
        if before.broken:
            is_better = True
        elif all(isinstance(c, PointRate | Pace) for c in corrections):
            relative = relative_misfit(verdict)
            limit = min(MAX_RATE_RATIO * before_relative, MAX_RATE_MISFIT)
            is_better = relative < limit
        else:
            is_better = verdict.misfit < MAX_MISFIT_RATIO * before.misfit
        is_right = verdict.is_consistent and verdict.is_predicted and is_better
        if is_right and falls_at_its_pace(corrected, verdict):
            proposals.append(Proposal(corrections, verdict))
    return sorted(proposals, key=lambda proposal: proposal.verdict.misfit)


def relative_misfit(verdict: Verdict) -> float:
    """Return the misfit over the motion of the points in the predicted time.

    At a slower pace there is less motion in it, and a smaller misfit of any model.
    """
    length = verdict.measured.length
    if length is None or not verdict.misfits:
        return 0.0
    tip = farthest_point(verdict.measured)
    motions = []
    for recording in verdict.measured.recordings:
        track = recording.track(tip)
        if recording.name in verdict.misfits and track is not None:
            motions.append(mean_motion(track, length))
    motion = float(np.median(motions)) if motions else 0.0
    return verdict.misfit / max(motion, MIN_MOTION)


def falls_at_its_pace(measured: Measurements, verdict: Verdict) -> bool:
    """Return whether no other pace of all clocks fits much better.

    With a unit of length wrong by a factor of four, a string falls in slow motion.
    """
    limit = MAX_RATE_RATIO * relative_misfit(verdict)
    for factor in (0.5, 2.0):
        other = scale_all_times(measured, factor)
        if not is_impossible(other) and relative_misfit(judge(other)) < limit:
            return False
    return True


def is_seen_near_hand(measured: Measurements, length: float) -> bool:
    """Return whether all stated arc lengths are in the first part of the string."""
    stated = measured.stated_arc_lengths
    return bool(stated) and max(stated) < MIN_SEEN_LENGTH * length


def keep_rivals(proposals: list[Proposal]) -> list[Proposal]:
    """Return the proposals that fit about as well as the first."""
    if not proposals:
        return []
    best = proposals[0].verdict.misfit
    limit = max(RIVAL_RATIO * best, best + RIVAL_MARGIN)
    return [proposal for proposal in proposals if proposal.verdict.misfit <= limit]
