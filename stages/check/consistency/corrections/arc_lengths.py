"""Corrections of wrong arc lengths."""

from __future__ import annotations

from dataclasses import replace

from stringcast.data.metadata import DATASET_FILE
from stringcast.stages.check.consistency.corrections.base import Correction
from stringcast.stages.check.consistency.record import Measurements, Recording, Track

MIN_LENGTH_RATIO = 1.3  # of a wrong length to the arc length of the last point


class CountedFromTip(Correction):
    """Arc lengths are counted from the other end."""

    table = "points"
    field = "s"
    statement = "arc lengths are counted from the tip, not from the grasp"
    remedy = "Replace s by string.length - s"

    def undo(self, measured: Measurements) -> Measurements | None:
        length = measured.length
        if length is None or any(track.s is None for track in measured.tracks):
            return None

        def reverse(track: Track) -> Track:
            return replace(track, s=length - (track.s or 0.0))

        return measured.with_tracks(reverse)


class EndsAtLastPoint(Correction):
    """The stated length is much larger than the arc length of the last point."""

    table = DATASET_FILE
    field = "string.length"
    statement = "the string ends at its last point, and is not as long as stated"
    remedy = "Correct s or string.length"

    def undo(self, measured: Measurements) -> Measurements | None:
        stated, length = measured.stated_arc_lengths, measured.length
        if length is None or not stated or length < MIN_LENGTH_RATIO * max(stated):
            return None
        return replace(measured, length=max(stated))


class ExchangedPoints(Correction):
    """The arc lengths of two points are exchanged."""

    table = "points"
    field = "s"
    statement = "the two points have changed places along the string"
    remedy = "Exchange their s"

    def undo(self, measured: Measurements) -> Measurements | None:
        for recording in measured.recordings:
            lengths = {track.s for track in recording.tracks}
            if len(recording.tracks) != 2 or len(lengths) != 2 or None in lengths:
                return None

        def exchange(recording: Recording) -> Recording:
            first, second = recording.tracks
            exchanged = (replace(first, s=second.s), replace(second, s=first.s))
            return replace(recording, tracks=exchanged)

        return measured.with_recordings(exchange)


ARC_LENGTHS = (CountedFromTip(), EndsAtLastPoint(), ExchangedPoints())
