"""Corrections of the unit of lengths and positions."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from stringcast.data.metadata import DATASET_FILE
from stringcast.stages.check.consistency.corrections.base import Correction
from stringcast.stages.check.consistency.record import Measurements, Recording, Track
from stringcast.stages.model.camera import Camera

UNITS = {
    "millimetres": 1e-3,
    "centimetres": 1e-2,
    "inches": 0.0254,
    "decimetres": 0.1,
}
# right unit over a wrong stated unit
RATIOS = {"10": 10.0, "25.4": 25.4, "2.54": 2.54, "1000": 1e3, "100": 1e2, "0.1": 0.1}
LENGTH_PARTS = ("xy", "s", "length", "hand", "links", "base")


class LengthField(NamedTuple):
    """A place where lengths may have a wrong unit.

    table, field: the place. subject, target: words that begin the statement, and the
    object of the remedy. parts: the lengths that have the unit.
    """

    table: str
    field: str
    subject: str
    target: str
    parts: tuple[str, ...]


LENGTH_FIELDS = (
    LengthField("points", "x, y", "positions are", "x and y", ("xy",)),
    LengthField("points", "s", "arc lengths are", "s", ("s",)),
    LengthField(DATASET_FILE, "string.length", "it is", "it", ("length",)),
    LengthField("grasp", "x, y", "positions are", "x and y", ("hand",)),
    LengthField(DATASET_FILE, "arm.links", "they are", "them", ("links",)),
    LengthField(DATASET_FILE, "arm.base", "it is", "it", ("base",)),
    LengthField(
        DATASET_FILE, "arm.links, arm.base", "both are", "both", ("links", "base")
    ),
    LengthField("points", "s, x, y", "all three are", "s, x and y", ("s", "xy")),
    LengthField(
        "grasp", "x, y", "here and in points, positions are", "both", ("hand", "xy")
    ),
    LengthField("points", "s", "s and string.length are", "both", ("s", "length")),
    LengthField(
        "points",
        "s, x, y",
        "these, string.length and the hand's positions are",
        "all of them, and arm.links and arm.base,",
        LENGTH_PARTS,
    ),
)


@dataclass(frozen=True, kw_only=True)
class WrongUnit(Correction):
    """Lengths are in a unit of `factor` metres, or of `factor` stated units.

    parts: the lengths that have this unit.
    """

    table: str
    field: str
    statement: str
    remedy: str
    parts: tuple[str, ...]
    factor: float

    def undo(self, measured: Measurements) -> Measurements | None:
        return scale_lengths(measured, self.factor, self.parts)


def unit_corrections() -> Iterator[WrongUnit]:
    """Yield corrections of lengths in another unit than metres."""
    for unit, factor in UNITS.items():
        for place in LENGTH_FIELDS:
            yield WrongUnit(
                table=place.table,
                field=place.field,
                statement=f"{place.subject} in {unit}, not in metres",
                remedy=f"Multiply {place.target} by {factor:g}",
                parts=place.parts,
                factor=factor,
            )


def ratio_corrections() -> Iterator[WrongUnit]:
    """Yield corrections of positions whose stated unit is wrong."""
    for text, factor in RATIOS.items():
        yield WrongUnit(
            table="points",
            field="x, y",
            statement=f"positions are in a unit {text} times that which is stated",
            remedy=f"Multiply x and y by {text}",
            parts=("xy",),
            factor=factor,
        )


def scale_lengths(
    measured: Measurements, factor: float, parts: Collection[str]
) -> Measurements | None:
    """Multiply some lengths by a factor; None if one of the parts is missing."""
    is_stated = {
        "xy": True,
        "s": bool(measured.stated_arc_lengths),
        "length": measured.length is not None,
        "hand": any(r.hand is not None for r in measured.recordings),
        "links": measured.has_joints,
        "base": measured.has_joints and any(measured.base),
    }
    is_of_all = len(parts) == len(LENGTH_PARTS)
    if not is_of_all and not all(is_stated[part] for part in parts):
        return None
    scale = {part: factor if part in parts else 1.0 for part in LENGTH_PARTS}
    pose_scale = np.array([scale["hand"], scale["hand"], 1.0])

    def scale_track(track: Track) -> Track:
        s = None if track.s is None else track.s * scale["s"]
        return replace(track, s=s, xy=track.xy * scale["xy"])

    def scale_pose(recording: Recording) -> Recording:
        if recording.hand is None:
            return recording
        return replace(recording, hand=recording.hand * pose_scale)

    x, y = measured.base
    scaled = measured.with_tracks(scale_track).with_recordings(scale_pose)
    length = measured.length
    return replace(
        scaled,
        length=None if length is None else scale["length"] * length,
        links=tuple(scale["links"] * link for link in measured.links),
        base=(scale["base"] * x, scale["base"] * y),
    )


@dataclass(frozen=True)
class PositionsInPixels(Correction):
    """Positions of points are in pixels of a camera."""

    table = "points"
    field = "x, y"
    statement = "positions are in pixels, not in metres"
    remedy = (
        "Take x = (u - camera.origin_px[0]) / camera.px_per_m and "
        "y = (camera.origin_px[1] - v) / camera.px_per_m"
    )
    camera: Camera

    def undo(self, measured: Measurements) -> Measurements | None:
        def convert(track: Track) -> Track:
            return replace(track, xy=self.camera.world(track.xy))

        return measured.with_tracks(convert)
