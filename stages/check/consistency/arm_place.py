"""Estimate of the arm's base from the string at rest and its motion."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from stringcast.data.metadata import DATASET_FILE
from stringcast.stages.check.consistency.corrections.base import (
    Correction,
    apply_corrections,
)
from stringcast.stages.check.consistency.judge import (
    CONSISTENT_MISFIT,
    MAX_TRIALS,
    RIVAL_RATIO,
    fit_trial,
)
from stringcast.stages.check.consistency.prediction import (
    TICK_S,
    Prediction,
    mean_motion,
    predict,
    thin_track,
)
from stringcast.stages.check.consistency.record import Measurements, Recording, Track

# lengths that are tried if neither length nor base is known [m]
UNKNOWN_LENGTHS_M = np.geomspace(0.12, 1.5, 12)
BASE_STEPS = 3
# In 20 right datasets of another simulator, also with only the tip, the best base has
# an error of up to 11 mm, and is up to 25 mm from others that fit equally well
MAX_PLACE_ERROR_M = 0.011
PLACE_MARGIN = 0.01
MAX_PLACE_UNCERTAINTY_M = 0.05  # of a base that is proposed
# From the stated base: in 45 right datasets the best one differs by up to 30 mm, if the
# ladder has no similar string, such as a soft one in a clamp
MIN_SHIFT_M = 0.04
MIN_AMPLITUDE_RATIO = 2.0  # of the points' motion over the misfit, for a fitted base


class ArmPlaces(NamedTuple):
    """Fitted places of the arm, one for each stiffness, tip and length.

    Attributes
    ----------
    misfits
        Misfits with these places (N,), in lengths.
    places
        Places of joint 1 (N, 2) [m].
    motions
        Mean motion of the tip (N,), in lengths.
    """

    misfits: np.ndarray
    places: np.ndarray
    motions: np.ndarray

    @classmethod
    def join(cls, fits: Sequence[ArmPlaces]) -> ArmPlaces:
        """Join the places of several fits into one list."""
        return cls(*map(np.concatenate, zip(*fits, strict=True)))


@dataclass(frozen=True, kw_only=True)
class ArmElsewhere(Correction):
    """The arm's joint 1 stands at another place.

    place: (2,) [m]. is_shown: whether the motion determines it well enough.
    """

    table = DATASET_FILE
    field = "arm.base"
    statement: str
    remedy: str
    place: tuple[float, float]
    is_shown: bool

    def undo(self, measured: Measurements) -> Measurements | None:
        """Move the arm to the place."""
        return replace(measured, base=self.place)


def base_corrections(
    measured: Measurements, first: tuple[Correction, ...]
) -> Iterator[tuple[Correction, ...]]:
    """Yield the fitted place of the arm after some first corrections.

    A stated place with other signs or in another order replaces a fitted one near it. A
    measured place is not fitted, because the model of the string is rough.
    """
    corrected = apply_corrections(measured, first)
    if corrected is None or not corrected.has_joints or corrected.base_is_measured:
        return
    lengths = [corrected.length] if corrected.length else list(UNKNOWN_LENGTHS_M)
    fits = []
    for length in lengths:
        fit = fit_base(replace(corrected, length=float(length)))
        if fit is not None:
            fits.append(fit)
    if not fits:
        return
    fitted = ArmPlaces.join(fits)
    best = int(fitted.misfits.argmin())
    misfit = float(fitted.misfits[best])
    # if the points hardly move, any string fits them at some place
    shows_place = fitted.motions[best] >= MIN_AMPLITUDE_RATIO * misfit
    if misfit > CONSISTENT_MISFIT or not shows_place:
        return
    shift_m = np.linalg.norm(fitted.places[best] - corrected.base)
    if shift_m < MIN_SHIFT_M:
        return
    is_rival = fitted.misfits <= max(RIVAL_RATIO * misfit, misfit + PLACE_MARGIN)
    distances = np.linalg.norm(fitted.places[is_rival] - fitted.places[best], axis=1)
    uncertainty = float(distances.max())
    meant = intended_base(corrected.base, fitted.places[best])
    if meant is not None and uncertainty <= MAX_PLACE_UNCERTAINTY_M:
        yield (*first, mistyped_base_correction(corrected.base, meant))
    else:
        yield (*first, base_correction(fitted.places[best], uncertainty))


def intended_base(
    stated: tuple[float, float], place: np.ndarray
) -> tuple[float, float] | None:
    """Return the stated base with other signs or exchanged, if one is at a place.

    It is then more precise than the fit of the place (2,) [m].
    """
    x, y = stated
    signs = np.array([(1, 1), (1, -1), (-1, 1), (-1, -1)])
    variants = np.concatenate([signs * (x, y), signs * (y, x)])
    distances = np.linalg.norm(variants - place, axis=1)
    nearest = int(distances.argmin())
    if distances[nearest] > MAX_PLACE_ERROR_M:
        return None
    return float(variants[nearest, 0]), float(variants[nearest, 1])


def mistyped_base_correction(
    stated: tuple[float, float], meant: tuple[float, float]
) -> ArmElsewhere:
    """Return the correction of the signs or the order of a stated base [m]."""
    x, y = meant
    return ArmElsewhere(
        statement=(
            f"the base has a wrong sign or order: ({stated[0]:g}, {stated[1]:g}) m is "
            f"stated, and the string's motion fits ({x:g}, {y:g}) m"
        ),
        remedy=f"Write base: [{x:g}, {y:g}]",
        place=meant,
        is_shown=True,
    )


def base_correction(place: np.ndarray, uncertainty: float) -> ArmElsewhere:
    """Return the correction that puts the arm to a place (2,) [m].

    Others at a distance of `uncertainty` [m] fit as well.
    """
    x, y = (round(float(value), 3) for value in place)
    is_shown = uncertainty <= MAX_PLACE_UNCERTAINTY_M
    fit = f"about ({x:.3f}, {y:.3f}) m"
    advice = f"; a fit says base: [{x:.3f}, {y:.3f}]"
    if not is_shown:
        fit += f", but also others up to {uncertainty:.2g} m from it"
        advice = ", as the motion does not show it well enough"
    return ArmElsewhere(
        statement=f"the arm stands elsewhere: the string's motion fits a base of {fit}",
        remedy=f"Measure where joint 1 sits in the coordinates of the points{advice}",
        place=(x, y),
        is_shown=is_shown,
    )


def fit_base(measured: Measurements) -> ArmPlaces | None:
    """Fit the place of joint 1, for each stiffness of the ladder and each possible tip.

    The prediction does not depend on the place. So the shift of the arm is that of the
    points from their prediction: first at rest, then over the motion.
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
    fitted = ArmPlaces.join(fits)
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
        motions.append(mean_motion(track, prediction.length))
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
    """Return misfits (C,) of shifted predictions, and remaining shifts (C, 2)."""
    misfits = []
    residuals = []
    for recording, prediction in trials:
        moved = replace(prediction, nodes=prediction.nodes + shift[:, None, None])
        track = recording.track(tip)
        fit = fit_trial(moved, recording, tip)
        if track is None or fit is None:
            continue
        thinned = thin_track(track, moved.length)
        misfits.append(fit.misfits)
        residuals.append(median_residuals(moved, thinned, fit.offsets))
    if not misfits:
        return np.full(len(shift), np.inf), np.zeros_like(shift)
    return np.median(misfits, axis=0), np.median(residuals, axis=0)


def median_residuals(
    prediction: Prediction, track: Track, offsets: np.ndarray
) -> np.ndarray:
    """Return the median distance (C, 2) of the tip from its prediction [m].

    It is 0 for strings that end before the track begins.
    """
    points = prediction.points(track.s or prediction.length)  # (C, N, 2)
    last = len(prediction.t) - 1
    ticks = (track.t + offsets[:, None] - prediction.t[0]) / TICK_S
    index = np.rint(ticks).astype(int)  # (C, F)
    rungs = np.arange(len(offsets))[:, None]
    residuals = track.xy - points[rungs, np.clip(index, 0, last)]  # (C, F, 2)
    is_within = index <= last
    # Median of those within, which are sorted before the others
    ordered = np.sort(np.where(is_within[..., None], residuals, np.inf), axis=1)
    counts = is_within.sum(axis=1)  # (C,)
    lower = ordered[rungs[:, 0], np.maximum(counts - 1, 0) // 2]
    upper = ordered[rungs[:, 0], np.minimum(counts // 2, len(track.t) - 1)]
    return np.where(counts[:, None] > 0, 0.5 * (lower + upper), 0.0)
