"""Search for the corrections after which measurements are consistent."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from stringcast.data.metadata import DATASET_FILE
from stringcast.stages.check.consistency.corrections import (
    DIRECTIONS,
    PACES,
    RATES,
    Correction,
    scale_all_times,
    single_corrections,
)
from stringcast.stages.check.consistency.judge import (
    CONSISTENT_MISFIT,
    MAX_TRIALS,
    Verdict,
    farthest_point,
    fit_trial,
    judge,
)
from stringcast.stages.check.consistency.limits import broken_limits
from stringcast.stages.check.consistency.prediction import (
    TICK_S,
    Prediction,
    predict,
    thin_track,
)
from stringcast.stages.check.consistency.record import (
    Measurements,
    Recording,
    Track,
)
from stringcast.stages.model.camera import Camera

# an arm casts no shorter and no longer string
MIN_CORRECTED_LENGTH_M, MAX_CORRECTED_LENGTH_M = 0.05, 2.0
# of a correction, over the misfit before. In 15 right datasets of other simulators a
# fitted base leaves 0.6 to 1.2 of it, half or double rates 1.2 to 20 times as much.
MAX_MISFIT_RATIO = 0.4
MAX_RATE_RATIO = 0.6
WORST_PERFECT_MISFIT = 0.03  # no mistake is looked for below
MAX_RIGHT_MISFIT = 0.06  # of a correction: beyond, others are tried, too
# others fit as well if their misfit is at most so many times as large, or so much more
RIVAL_RATIO, RIVAL_MARGIN = 1.5, 0.03
SUSPICIOUS_MISFIT = 0.1  # a trial that misses by more may belong to another hand
# lengths that are tried where neither length nor base is known [m]
UNKNOWN_LENGTHS_M = np.geomspace(0.12, 1.5, 12)
MIN_SEEN_LENGTH = 0.3  # of the corrected string
BASE_STEPS = 3
# In 20 right datasets of another simulator, also with the tip alone, the best place of
# the arm is up to 11 mm off, and up to 25 mm from others that fit as well.
PLACE_MARGIN = 0.01
MAX_PLACE_DOUBT_M = 0.05  # of a base that is proposed
MIN_MOTION = 0.01  # of points, in lengths: less is none
MIN_AMPLITUDE_RATIO = 2.0  # of the points' motion over the misfit, for a fitted base


@dataclass(frozen=True)
class Proposal:
    """Corrections that make measurements consistent."""

    corrections: tuple[Correction, ...]
    verdict: Verdict


@dataclass(frozen=True)
class Answer:
    """The corrections, or the pairing, that make measurements consistent.

    Attributes
    ----------
    proposals
        Corrections, the best first. More than one means that the data do not decide.
    pairing
        The trial whose points fit, by the trial of the hand, where they differ.
    """

    proposals: Sequence[Proposal] = ()
    pairing: Mapping[str, str] = field(default_factory=dict)


def find_answer(
    measured: Measurements, before: Verdict, camera: Camera | None = None
) -> Answer:
    """Return what would make measurements consistent; nothing if they are.

    Single corrections are tried first, then another pairing of trials, then another
    place of the arm, then pairs of corrections. The later ones are tried, too, where a
    single correction leaves more than right data do: it may fit by chance.

    Parameters
    ----------
    measured
        The measurements.
    before
        Their verdict.
    camera
        The camera whose pixels positions may be in.
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
        base_corrections(measured, ()),
        pair_candidates(measured, singles),
    ):
        if not fits_as_right_data(proposals):
            others = consistent_proposals(measured, before, candidates)
            proposals = add_better_proposals(proposals, others)
    return Answer(keep_rivals(proposals))


def fits_as_right_data(proposals: Sequence[Proposal]) -> bool:
    """Return whether the best proposal leaves no more than right data do."""
    return bool(proposals) and proposals[0].verdict.misfit < MAX_RIGHT_MISFIT


def add_better_proposals(
    simpler: list[Proposal], others: list[Proposal]
) -> list[Proposal]:
    """Return proposals with those others that fit much better, the best first.

    Others have more freedom, so that they would always fit a little better.
    """
    if not simpler:
        return others
    limit = MAX_MISFIT_RATIO * simpler[0].verdict.misfit
    better = [proposal for proposal in others if proposal.verdict.misfit < limit]
    return sorted([*better, *simpler], key=lambda proposal: proposal.verdict.misfit)


def find_silent_mistake(measured: Measurements, before: Verdict) -> Answer:
    """Return a mistake of measurements that are consistent, but fit better without it.

    A similar motion of another trial, a rate and a base that is off a little leave a
    possible string.
    """
    pairing = find_pairing(measured, before)
    if pairing or before.misfit < WORST_PERFECT_MISFIT:
        return Answer(pairing=pairing)
    candidates = [
        *((rate,) for rate in (*RATES, *PACES)),
        *base_corrections(measured, ()),
    ]
    proposals = consistent_proposals(measured, before, candidates)
    return Answer(keep_rivals(proposals))


def pair_candidates(
    measured: Measurements, singles: Iterable[Correction]
) -> Iterator[tuple[Correction, ...]]:
    """Yield pairs of corrections that people need."""
    singles = list(singles)
    # with s in another unit, all points would lie at one place
    units = [c for c in singles if c.kind == "unit" and "s" not in c.parts]
    kinds = ("y_down", "x_left", "exchange_axes", "degrees", "absolute")
    others = [c for c in singles if c.kind in kinds]
    yield from product(units, others)
    angles = [c for c in others if c not in DIRECTIONS]
    yield from product(DIRECTIONS, angles)
    points = [c for c in units if c.parts == ("xy",)]
    for correction in (*DIRECTIONS, *points, *angles):
        yield from base_corrections(measured, (correction,))


def consistent_proposals(
    measured: Measurements,
    before: Verdict,
    candidates: Iterable[tuple[Correction, ...]],
) -> list[Proposal]:
    """Return the candidates that end in consistent measurements."""
    proposals = []
    before_relative = relative_misfit(before)
    for corrections in candidates:
        corrected = apply_corrections(measured, corrections)
        if corrected is None or broken_limits(corrected):
            continue
        verdict = judge(corrected)
        length = verdict.measured.length or 0.0
        is_castable = MIN_CORRECTED_LENGTH_M < length < MAX_CORRECTED_LENGTH_M
        if not is_castable or is_seen_near_hand(corrected, length):
            continue
        kinds = {correction.kind for correction in corrections}
        if before.broken:
            is_better = True
        elif kinds <= {"rate", "pace"}:
            is_better = relative_misfit(verdict) < MAX_RATE_RATIO * before_relative
        else:
            is_better = verdict.misfit < MAX_MISFIT_RATIO * before.misfit
        is_right = verdict.is_consistent and verdict.is_predicted and is_better
        if is_right and falls_at_its_pace(corrected, verdict):
            proposals.append(Proposal(corrections, verdict))
    return sorted(proposals, key=lambda proposal: proposal.verdict.misfit)


def relative_misfit(verdict: Verdict) -> float:
    """Return the misfit over the motion of the points that are looked at.

    At a slower pace there is less of it, and every model is nearer to it.
    """
    length = verdict.measured.length
    if length is None or not verdict.misfits:
        return 0.0
    tip = farthest_point(verdict.measured)
    motions = []
    for recording in verdict.measured.recordings:
        track = recording.track(tip)
        if recording.name in verdict.misfits and track is not None:
            motions.append(motion_of(track, length))
    motion = float(np.median(motions)) if motions else 0.0
    return verdict.misfit / max(motion, MIN_MOTION)


def motion_of(track: Track, length: float) -> float:
    """Return the mean distance of a point from its middle, in lengths."""
    xy = thin_track(track, length).xy
    distance = np.linalg.norm(xy - xy.mean(axis=0), axis=1)
    return float(distance.mean()) / length


def falls_at_its_pace(measured: Measurements, verdict: Verdict) -> bool:
    """Return whether no other pace of all clocks fits much better.

    A unit of length that is wrong by a factor of four falls as if in slow motion.
    """
    limit = MAX_RATE_RATIO * relative_misfit(verdict)
    for factor in (0.5, 2.0):
        other = scale_all_times(measured, factor)
        if not broken_limits(other) and relative_misfit(judge(other)) < limit:
            return False
    return True


def is_seen_near_hand(measured: Measurements, length: float) -> bool:
    """Return whether all points of stated arc length are in the string's beginning."""
    stated = measured.stated_arc_lengths
    return bool(stated) and max(stated) < MIN_SEEN_LENGTH * length


def apply_corrections(
    measured: Measurements, corrections: Iterable[Correction]
) -> Measurements | None:
    """Undo mistakes one after another; None if one of them cannot be there."""
    corrected: Measurements | None = measured
    for correction in corrections:
        if corrected is not None:
            corrected = correction.undo(corrected)
    return corrected


def keep_rivals(proposals: list[Proposal]) -> list[Proposal]:
    """Return the proposals that fit about as well as the first."""
    if not proposals:
        return []
    best = proposals[0].verdict.misfit
    limit = max(RIVAL_RATIO * best, best + RIVAL_MARGIN)
    return [proposal for proposal in proposals if proposal.verdict.misfit <= limit]


# --- the place of the arm ----------------------------------------------------


class ArmPlaces(NamedTuple):
    """Places of the arm that were fitted, one for each string that is tried.

    Attributes
    ----------
    misfits
        Of the places (N,), in lengths.
    places
        Where joint 1 sits (N, 2) [m].
    motions
        Mean motion of the tip (N,), in lengths.
    """

    misfits: np.ndarray
    places: np.ndarray
    motions: np.ndarray


def base_corrections(
    measured: Measurements, first: tuple[Correction, ...]
) -> Iterator[tuple[Correction, ...]]:
    """Yield the arm's place that the string at rest and its motion show."""
    corrected = apply_corrections(measured, first)
    if corrected is None or not corrected.has_joints:
        return
    lengths = [corrected.length] if corrected.length else list(UNKNOWN_LENGTHS_M)
    fits = []
    for length in lengths:
        fit = fit_base(replace(corrected, length=float(length)))
        if fit is not None:
            fits.append(fit)
    if not fits:
        return
    fitted = ArmPlaces(*map(np.concatenate, zip(*fits, strict=True)))
    best = int(fitted.misfits.argmin())
    misfit = float(fitted.misfits[best])
    # where the points hardly move, any string fits them at some place
    shows_place = fitted.motions[best] >= MIN_AMPLITUDE_RATIO * misfit
    if misfit > CONSISTENT_MISFIT or not shows_place:
        return
    is_rival = fitted.misfits <= max(RIVAL_RATIO * misfit, misfit + PLACE_MARGIN)
    distances = np.linalg.norm(fitted.places[is_rival] - fitted.places[best], axis=1)
    yield (*first, base_correction(fitted.places[best], float(distances.max())))


def base_correction(place: np.ndarray, doubt: float) -> Correction:
    """Return the correction that puts the arm to a place (2,) [m].

    It states no place if others at a distance of `doubt` [m] fit as well.
    """
    x, y = (round(float(value), 3) for value in place)
    values: tuple[float, ...] = (x, y)
    fit = f"about ({x:.3f}, {y:.3f}) m"
    advice = f"; a fit says base: [{x:.3f}, {y:.3f}]"
    if doubt > MAX_PLACE_DOUBT_M:
        values = ()
        fit += f", but also others up to {doubt:.2g} m from it"
        advice = ", as the motion does not show it well enough"
    return Correction(
        DATASET_FILE,
        "arm.base",
        f"the arm stands elsewhere: the string's motion fits a base of {fit}",
        f"Measure where joint 1 sits in the coordinates of the points{advice}",
        lambda measured: replace(measured, base=(x, y)),
        "base",
        values=values,
    )


def fit_base(measured: Measurements) -> ArmPlaces | None:
    """Fit where joint 1 sits, for each stiffness of the ladder and each possible tip.

    A string moves alike everywhere, so the arm's place is off by what points are off
    from their prediction: first at rest, by stiffness, then over the motion.
    """
    trials: list[tuple[Recording, Prediction]] = []
    for recording in measured.recordings[:MAX_TRIALS]:
        prediction = predict(measured, recording)
        if prediction is not None:
            trials.append((recording, prediction))
    if not trials:
        return None
    # which point rests farthest from the hand is unknown, too
    tips = {track.point for recording, _ in trials for track in recording.tracks}
    fits = [fit_base_of_tip(trials, tip) for tip in sorted(tips)]
    fitted = ArmPlaces(*map(np.concatenate, zip(*fits, strict=True)))
    return fitted._replace(places=np.asarray(measured.base) + fitted.places)


def fit_base_of_tip(trials: list[tuple[Recording, Prediction]], tip: str) -> ArmPlaces:
    """Fit shifts of the base for each stiffness (C,), if a point is the tip."""
    gaps = []
    motions = []
    for recording, prediction in trials:
        track = recording.track(tip)
        if track is None:
            continue
        s = track.s or prediction.length
        gaps.append(track.rest_place - prediction.points(s)[:, 0])
        motions.append(motion_of(track, prediction.length))
    shift = np.median(gaps, axis=0)  # (C, 2)
    misfits, places = np.full(len(shift), np.inf), shift
    for _ in range(BASE_STEPS):
        new_misfits, residuals = shifted_fits(trials, tip, shift)
        is_better = new_misfits < misfits
        if not is_better.any():
            break
        misfits = np.where(is_better, new_misfits, misfits)
        places = np.where(is_better[:, None], shift, places)
        shift = shift + residuals
    motion = np.full(len(shift), float(np.median(motions)))
    return ArmPlaces(misfits, places, motion)


def shifted_fits(
    trials: list[tuple[Recording, Prediction]], tip: str, shift: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return misfits (C,) of predictions that are shifted, and what is left (C, 2)."""
    misfits = []
    residuals = []
    for recording, prediction in trials:
        moved = replace(prediction, nodes=prediction.nodes + shift[:, None, None])
        fit = fit_trial(moved, recording, tip)
        if fit is None:
            continue
        track = recording.track(tip)
        if track is None:
            continue
        misfits.append(fit.misfits)
        residuals.append(
            median_residuals(moved, thin_track(track, moved.length), fit.offsets)
        )
    if not misfits:
        return np.full(len(shift), np.inf), np.zeros_like(shift)
    return np.median(misfits, axis=0), np.median(residuals, axis=0)


def median_residuals(
    prediction: Prediction, track: Track, offsets: np.ndarray
) -> np.ndarray:
    """Return the median distance (C, 2) of the tip from its prediction [m]."""
    points = prediction.points(track.s or prediction.length)
    residuals = []
    for rung, offset in enumerate(offsets):
        index = np.rint((track.t + offset - prediction.t[0]) / TICK_S).astype(int)
        is_within = index < len(prediction.t)
        places = points[rung, np.maximum(index[is_within], 0)]
        residuals.append(np.median(track.xy[is_within] - places, axis=0))
    return np.array(residuals)


# --- the pairing of trials ---------------------------------------------------


def tip_alone(recording: Recording, tip: str) -> Recording:
    """Return a trial with the tip as its only point."""
    tracks = tuple(track for track in recording.tracks if track.point == tip)
    return replace(recording, tracks=tracks)


def find_pairing(measured: Measurements, verdict: Verdict) -> dict[str, str]:
    """Return whose points belong to which trial's hand, if not to their own.

    Parameters
    ----------
    measured
        The measurements.
    verdict
        Their verdict.

    Returns
    -------
    dict
        The trial whose points fit, by the trial of the hand; only where they differ.
    """
    if measured.length is None or any(
        limit.kind != "gap" for limit in verdict.broken.values()
    ):
        return {}
    is_suspicious = max(verdict.misfits.values(), default=0.0) > SUSPICIOUS_MISFIT
    if not (verdict.broken or is_suspicious):
        return {}
    recordings = measured.recordings[: 2 * MAX_TRIALS]
    costs = pairing_costs(measured, recordings)
    if costs is None:
        return {}
    order, rung = cheapest_pairing(costs)
    own = np.arange(len(recordings))
    changed = own[order != own]
    if not len(changed):
        return {}
    new = costs[changed, order[changed], rung]
    own_rung = int(costs[own, own].sum(axis=0).argmin())
    old = costs[changed, changed, own_rung]
    if new.max() > CONSISTENT_MISFIT or new.mean() > MAX_MISFIT_RATIO * old.mean():
        return {}
    return {recordings[i].name: recordings[order[i]].name for i in changed}


def pairing_costs(
    measured: Measurements, recordings: Sequence[Recording]
) -> np.ndarray | None:
    """Return the misfit of each trial's tip in each trial's hand, (N, N, C).

    The first index is that of the hand, the last the rung of the ladder. None if there
    is one trial only, or if a hand predicts nothing.
    """
    if len(recordings) < 2:
        return None
    tip = farthest_point(measured)
    tips = [tip_alone(recording, tip) for recording in recordings]
    rows = []
    for recording in recordings:
        prediction = predict(measured, recording)
        if prediction is None:
            return None
        row = []
        for other in tips:
            fit = fit_trial(prediction, other, tip) if other.tracks else None
            row.append(np.ones(len(prediction.nodes)) if fit is None else fit.misfits)
        rows.append(row)
    return np.array(rows)


def cheapest_pairing(costs: np.ndarray) -> tuple[np.ndarray, int]:
    """Return the track of each hand (N,), and the rung at which they fit best."""
    hands = np.arange(len(costs))
    pairings = []
    for rung in range(costs.shape[2]):
        _, order = linear_sum_assignment(costs[:, :, rung])
        pairings.append((float(costs[hands, order, rung].sum()), rung, order))
    _, rung, order = min(pairings, key=lambda pairing: pairing[:2])
    return order, rung
