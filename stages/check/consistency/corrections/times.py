"""Corrections of clock rates."""

from __future__ import annotations

from dataclasses import dataclass, replace

from stringcast.stages.check.consistency.corrections.base import Correction
from stringcast.stages.check.consistency.record import Measurements, Recording, Track


@dataclass(frozen=True, kw_only=True)
class PointRate(Correction):
    """The frame rate of the points is wrong: times must be multiplied by `factor`."""

    table = "points"
    field = "t"
    statement: str
    remedy: str
    factor: float

    def undo(self, measured: Measurements) -> Measurements | None:
        return scale_point_times(measured, self.factor)


@dataclass(frozen=True, kw_only=True)
class Pace(Correction):
    """Both clocks have the same wrong rate or unit, by a factor."""

    table = "arm, points"
    field = "t"
    statement: str
    remedy: str
    factor: float

    def undo(self, measured: Measurements) -> Measurements | None:
        return scale_all_times(measured, self.factor)


def point_rate(factor: float, words: str) -> PointRate:
    """Return the correction of the points' frame rate by a factor."""
    return PointRate(
        statement=f"times of the points run {words}",
        remedy=f"Multiply t, since the beginning of each trial, by {factor:.4g}: "
        "the frame rate was another",
        factor=factor,
    )


def pace(factor: float, words: str) -> Pace:
    """Return the correction of both clocks by a factor."""
    return Pace(
        statement=f"hand and string move at {words} the pace of a string that falls",
        remedy=(
            f"Multiply t of both by {factor:g}: it is slow motion, or in another unit"
        ),
        factor=factor,
    )


def scale_point_times(measured: Measurements, factor: float) -> Measurements:
    """Multiply the times of points since the beginning of each trial."""

    def change(recording: Recording) -> Recording:
        begin = min(float(track.t[0]) for track in recording.tracks)
        return recording.with_tracks(
            lambda track: replace(track, t=begin + factor * (track.t - begin))
        )

    return measured.with_recordings(change)


def scale_all_times(measured: Measurements, factor: float) -> Measurements:
    """Multiply the times of hands and points."""

    def scale_track(track: Track) -> Track:
        return replace(track, t=factor * track.t)

    def scale_hand(recording: Recording) -> Recording:
        return replace(recording, t=factor * recording.t)

    return measured.with_tracks(scale_track).with_recordings(scale_hand)


RATES = (
    point_rate(0.5, "half as fast as the arm's"),
    point_rate(2.0, "twice as fast as the arm's"),
    # 200 and 250 frames a second, 200 and 240, 25 and 30
    point_rate(0.8, "slower than the arm's by a fifth"),
    point_rate(1.25, "faster than the arm's by a quarter"),
    point_rate(5 / 6, "slower than the arm's by a sixth"),
    point_rate(1.2, "faster than the arm's by a fifth"),
)
PACES = (
    pace(0.125, "an eighth of"),
    pace(0.25, "a quarter of"),
    pace(0.5, "half"),
    pace(2.0, "twice"),
    pace(4.0, "four times"),
    pace(8.0, "eight times"),
)
