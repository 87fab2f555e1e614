"""The verdict on measurements from limits and from the misfit of a prediction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from stringcast.stages.check.consistency.limits import BrokenLimit, broken_limits
from stringcast.stages.check.consistency.prediction import (
    ARC_LENGTH_GRID,
    BEGINNING,
    STRAIGHT,
    WHOLE_MOTION,
    WITH_SET,
    Horizon,
    Prediction,
    clock_offsets,
    predict,
    thin_track,
    track_errors,
)
from stringcast.stages.check.consistency.record import Measurements, Recording, Track

MAX_TRIALS = 5  # more add little
# lengths that are tried if none is stated, over that of the hanging string: a stiff
# string is longer because it bends below the grasp
LENGTH_RATIOS = (1.0, 1.04, 1.1, 1.2, 1.35)
UNSEEN_END_RATIOS = (1.0, 1.3, 1.7, 2.3)  # over the largest s: the tip may be unseen
# median distance from the prediction, in lengths, of consistent and of wrong data
CONSISTENT_MISFIT = 0.12
WRONG_MISFIT = 0.25
# At the beginning of the motion, the misfit is 1 to 5.5 % in 22 right datasets of other
# simulators. It is 4 to 26 % in 42 datasets with a wrong base, joint order or length
# and a misfit between the limits above; more than 6 % in 39 of them.
MAX_BEGINNING_MISFIT = 0.06
# Misfit of bent strings over that of straight ones: 0.26 to 0.49 for four sets of 1.5
# rad, and 0.84 for a fifth; 0.75 to 1 for wrong bases and joint angles
MAX_BENT_RATIO = 0.6
# Misfit with a correction over that without: in 15 right datasets of other simulators
# it is 0.6 to 1.2 with a fitted base
MAX_MISFIT_RATIO = 0.4
RIVAL_RATIO = 1.5  # corrections whose misfits differ by a smaller factor fit as well
HOPELESS_TRIALS = 2  # after this many, and most so far, no others are predicted
FINE_STEPS_S = np.arange(-15, 16, 2.5) * 1e-3  # around the best coarse offset


@dataclass(frozen=True)
class TrialFit:
    """The fit of a trial to its prediction at each stiffness.

    Attributes
    ----------
    misfits
        Mean distances from the predicted strings (C,), over the arc length of the
        farthest point.
    offsets
        Best clock offsets (C,) [s].
    arc_lengths
        Best arc lengths of the tracks (C, T) [m].
    """

    misfits: np.ndarray
    offsets: np.ndarray
    arc_lengths: np.ndarray


@dataclass(frozen=True)
class Verdict:
    """The consistency of measurements.

    Attributes
    ----------
    measured
        The measurements, with the best length if none was stated.
    broken
        The limit that each impossible trial breaks, by trial.
    misfits
        Mean distance from the prediction by trial, in lengths.
    arc_lengths
        Best arc length of each point [m].
    """

    measured: Measurements
    broken: Mapping[str, BrokenLimit]
    misfits: Mapping[str, float] = field(default_factory=dict)
    arc_lengths: Mapping[str, float] = field(default_factory=dict)

    @property
    def misfit(self) -> float:
        """Median misfit of the trials, in lengths; 0 if nothing could be predicted."""
        return float(np.median([*self.misfits.values()])) if self.misfits else 0.0

    @property
    def misfit_m(self) -> float:
        """Median misfit of the trials [m]."""
        return self.misfit * (self.measured.length or 1.0)

    @property
    def is_predicted(self) -> bool:
        """Whether a trial could be predicted, or none begins at rest."""
        recordings = self.measured.recordings
        begin_moving = [r.starts_moving or r.is_restless for r in recordings]
        return bool(self.misfits) or all(begin_moving)

    @property
    def is_consistent(self) -> bool:
        """Whether nothing contradicts the measurements."""
        return not self.broken and self.misfit < CONSISTENT_MISFIT


def judge(measured: Measurements) -> Verdict:
    """Return the verdict on measurements."""
    broken = broken_limits(measured)
    if broken or not measured.recordings:
        return Verdict(measured, broken)
    if measured.length is not None:
        return judge_prediction(measured)
    verdicts = []
    for length in hanging_lengths(measured):
        stated = replace(measured, length=length)
        if not broken_limits(stated):
            verdicts.append(judge_prediction(stated))
            if verdicts[-1].is_consistent:
                return verdicts[-1]
    if not verdicts:
        return Verdict(measured, {})
    return min(verdicts, key=lambda verdict: verdict.misfit_m)


def reason_beside_geometry(verdict: Verdict) -> str:
    """State why a misfit may come from the string, not the geometry; empty if not.

    The string may be bent at rest. Or it may whip: then errors of the model grow, while
    wrong geometry causes a misfit from the beginning.
    """
    bent = judge_prediction(verdict.measured, set_angles=WITH_SET)
    if bent.is_consistent and bent.misfit < MAX_BENT_RATIO * verdict.misfit:
        return f"a string that rests bent would be {bent.misfit_m:.2g} m from them"
    if verdict.misfit < WRONG_MISFIT:
        beginning = judge_prediction(verdict.measured, BEGINNING)
        if beginning.misfit <= MAX_BEGINNING_MISFIT:
            return "at the beginning they are nearer, as for a string that whips"
    return ""


def hanging_lengths(measured: Measurements) -> list[float]:
    """Return possible lengths [m] from arc lengths, or from the string at rest."""
    stated = measured.stated_arc_lengths
    if stated:
        longest = float(np.quantile(stated, 0.95))
        return [ratio * longest for ratio in UNSEEN_END_RATIOS]
    chords = []
    for recording in measured.recordings:
        hand = measured.pose(recording)[0, :2]
        places = np.array([track.rest_place for track in recording.tracks])
        chords.append(np.linalg.norm(places - hand, axis=1).max())
    chord = float(np.median(chords))
    return [ratio * chord for ratio in LENGTH_RATIOS]


def judge_prediction(
    measured: Measurements,
    horizon: Horizon = WHOLE_MOTION,
    set_angles: Sequence[float] = STRAIGHT,
) -> Verdict:
    """Return the verdict from the prediction of a string of known length.

    set_angles: as in `predict`.
    """
    tip = farthest_point(measured)
    fits: dict[str, TrialFit] = {}
    for recording in measured.recordings[:MAX_TRIALS]:
        prediction = predict(measured, recording, horizon, set_angles)
        if prediction is not None:
            fit = fit_trial(prediction, recording, tip)
            if fit is not None:
                fits[recording.name] = fit
        if is_hopeless(fits):
            break
    return summarise_fits(measured, fits)


def is_hopeless(fits: Mapping[str, TrialFit]) -> bool:
    """Return whether several trials are far from all predictions."""
    far = [fit for fit in fits.values() if fit.misfits.min() > WRONG_MISFIT]
    return len(far) >= HOPELESS_TRIALS and 2 * len(far) > len(fits)


def summarise_fits(measured: Measurements, fits: Mapping[str, TrialFit]) -> Verdict:
    """Return the verdict at the stiffness with the smallest median misfit."""
    if not fits:
        return Verdict(measured, {})
    table = np.array([fit.misfits for fit in fits.values()])  # (trials, C)
    best = int(np.median(table, axis=0).argmin())
    misfits = {name: float(fit.misfits[best]) for name, fit in fits.items()}
    tracks = {r.name: r.tracks for r in measured.recordings}
    lengths: dict[str, list[float]] = {}
    for name, fit in fits.items():
        for track, s in zip(tracks[name], fit.arc_lengths[best], strict=True):
            lengths.setdefault(track.point, []).append(float(s))
    arc_lengths = {point: float(np.median(s)) for point, s in lengths.items()}
    return Verdict(measured, {}, misfits, arc_lengths)


def farthest_point(measured: Measurements) -> str:
    """Return the name of the point that rests farthest from the hand."""
    distances: dict[str, list[float]] = {}
    for recording in measured.recordings:
        hand = measured.pose(recording)[0, :2]
        for track in recording.tracks:
            distance = float(np.linalg.norm(track.rest_place - hand))
            distances.setdefault(track.point, []).append(distance)
    return max(distances, key=lambda name: float(np.median(distances[name])))


def fit_trial(
    prediction: Prediction, recording: Recording, tip: str
) -> TrialFit | None:
    """Fit a trial to its prediction at the best offset of the clocks.

    A point without a stated arc length gets the best one; that of the tip is the
    string's length.
    """
    tracks = thin_tracks(prediction, recording)
    if tracks is None:
        return None
    offsets = clock_offsets(prediction, tracks)
    if not len(offsets):
        return None
    rungs = np.arange(len(prediction.nodes))
    coarse, arcs = errors_by_offset(prediction, tracks, tip, offsets)
    near = offsets[coarse.min(axis=1).argmin()] + FINE_STEPS_S
    fine, fine_arcs = errors_by_offset(prediction, tracks, tip, near)
    offsets = np.concatenate([offsets, near])
    errors, arcs = np.concatenate([coarse, fine]), np.concatenate([arcs, fine_arcs])
    best = errors.argmin(axis=0)  # (C,)
    return TrialFit(errors[best, rungs], offsets[best], arcs[best, rungs])


def thin_tracks(prediction: Prediction, recording: Recording) -> list[Track] | None:
    """Return the thinned tracks of a predicted trial; None if a point is never seen."""
    length, horizon = prediction.length, prediction.horizon
    tracks = [thin_track(track, length, horizon) for track in recording.tracks]
    return tracks if all(len(track.t) for track in tracks) else None


def errors_by_offset(
    prediction: Prediction, tracks: list[Track], tip: str, offsets: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return mean errors (D, C) of all tracks and their best arc lengths (D, C, T)."""
    totals = np.zeros((len(offsets), len(prediction.nodes)))
    scale = max(track.s or prediction.length for track in tracks)
    arcs = np.empty((*totals.shape, len(tracks)))
    for number, track in enumerate(tracks):
        if track.s is not None:
            tried = np.array([track.s])
        elif track.point == tip:
            tried = np.array([prediction.length])
        else:
            tried = prediction.length * ARC_LENGTH_GRID
        errors = np.array(
            [track_errors(prediction, track, s, offsets, scale) for s in tried]
        )  # (S, D, C)
        totals += errors.min(axis=0) / len(tracks)
        arcs[:, :, number] = tried[errors.argmin(axis=0)]
    return totals, arcs
