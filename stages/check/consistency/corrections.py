"""The catalogue of corrections: each undoes one common mistake.

A correction is a small record. It returns the measurements without the mistake, and
says what to do with the files of a dataset; `import` knows the option that does it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import permutations
from typing import NamedTuple

import numpy as np

from stringcast.data.importers.reader import COUNTS_PER_TURN
from stringcast.data.metadata import DATASET_FILE
from stringcast.stages.check.consistency.record import Measurements, Recording, Track
from stringcast.stages.model.camera import Camera

MAX_PERMUTED_JOINTS = 3  # of more, only neighbours are exchanged
MIN_LENGTH_RATIO = 1.3  # of a stated length that may be another, to the last point
MIN_COUNT = 100.0  # joint angles that are counts go beyond


@dataclass(frozen=True, kw_only=True)
class Correction:
    """A common mistake and its undoing.

    Attributes
    ----------
    table, field
        Where the mistake was made.
    statement
        What is wrong.
    remedy
        How to undo it in the files of a dataset.
    undo
        Returns the measurements without the mistake; None if it cannot be there.
    kind
        Name of the mistake, by which `import` finds the option that undoes it.
    parts, factor
        Of a wrong unit of length: which lengths have it, and its size [m].
    zero
        Of an encoder's counts: the count at angle zero.
    order
        Of joints: the numbers of the columns in the right order.
    values
        What was fitted: the arm's base [m].
    """

    table: str
    field: str
    statement: str
    remedy: str
    undo: Callable[[Measurements], Measurements | None]
    kind: str
    parts: tuple[str, ...] = ()
    factor: float = 1.0
    zero: int = 0
    order: tuple[int, ...] = ()
    values: tuple[float, ...] = ()


# --- units of length ---------------------------------------------------------

UNITS = {
    "millimetres": 1e-3,
    "centimetres": 1e-2,
    "inches": 0.0254,
    "decimetres": 0.1,
}
# a unit that is stated can be wrong, too: the right one over the stated one
RATIOS = {"10": 10.0, "25.4": 25.4, "2.54": 2.54, "1000": 1e3, "100": 1e2, "0.1": 0.1}
LENGTH_PARTS = ("xy", "s", "length", "hand", "links", "base")


class LengthField(NamedTuple):
    """A place where lengths may have a wrong unit.

    table, field: the place. subject, target: how the statement begins there, and what
    the remedy multiplies. parts: the lengths that have the unit.
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


def scale_lengths(
    measured: Measurements, factor: float, parts: Collection[str]
) -> Measurements | None:
    """Multiply some lengths by a factor; None if there are none of a part."""
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


def unit_corrections() -> Iterator[Correction]:
    """Yield corrections of lengths in another unit."""
    for unit, factor in UNITS.items():
        for place in LENGTH_FIELDS:
            yield Correction(
                table=place.table,
                field=place.field,
                statement=f"{place.subject} in {unit}, not in metres",
                remedy=f"Multiply {place.target} by {factor:g}",
                undo=partial(scale_lengths, factor=factor, parts=place.parts),
                kind="unit",
                parts=place.parts,
                factor=factor,
            )


def ratio_corrections() -> Iterator[Correction]:
    """Yield corrections of positions that were read in a wrong unit."""
    for text, factor in RATIOS.items():
        yield Correction(
            table="points",
            field="x, y",
            statement=f"positions are in a unit {text} times that which is stated",
            remedy=f"Multiply x and y by {text}",
            undo=partial(scale_lengths, factor=factor, parts=("xy",)),
            kind="unit",
            parts=("xy",),
            factor=factor,
        )


def pixels_to_metres(measured: Measurements, camera: Camera) -> Measurements:
    """Convert positions of points from pixels."""
    return measured.with_tracks(lambda track: replace(track, xy=camera.world(track.xy)))


def pixel_correction(camera: Camera) -> Correction:
    """Return the correction of positions in pixels of a camera."""
    return Correction(
        table="points",
        field="x, y",
        statement="positions are in pixels, not in metres",
        remedy="Take x = (u - camera.origin_px[0]) / camera.px_per_m and "
        "y = (camera.origin_px[1] - v) / camera.px_per_m",
        undo=partial(pixels_to_metres, camera=camera),
        kind="pixels",
    )


# --- directions and arc lengths ----------------------------------------------


def map_points(measured: Measurements, matrix: np.ndarray) -> Measurements:
    """Multiply positions of points by a matrix (2, 2)."""
    return measured.with_tracks(lambda track: replace(track, xy=track.xy @ matrix.T))


def mirror_world(measured: Measurements) -> Measurements | None:
    """Turn y of points and of measured hands; None if the hand is an arm's."""
    if measured.has_joints:
        return None
    flip = np.array([1.0, -1.0, -1.0])  # of x, y and theta

    def mirror(recording: Recording) -> Recording:
        assert recording.hand is not None
        return replace(recording, hand=recording.hand * flip)

    points = map_points(measured, np.diag([1.0, -1.0]))
    return points.with_recordings(mirror)


def reverse_arc_lengths(measured: Measurements) -> Measurements | None:
    """Count arc lengths from the other end."""
    length = measured.length
    if length is None or any(track.s is None for track in measured.tracks):
        return None
    return measured.with_tracks(
        lambda track: replace(track, s=length - (track.s or 0.0))
    )


def end_at_last_point(measured: Measurements) -> Measurements | None:
    """End the string at its last point, if it is stated to be much longer."""
    stated, length = measured.stated_arc_lengths, measured.length
    if length is None or not stated or length < MIN_LENGTH_RATIO * max(stated):
        return None
    return replace(measured, length=max(stated))


def exchange_arc_lengths(measured: Measurements) -> Measurements | None:
    """Exchange the arc lengths of two points."""

    def exchange(recording: Recording) -> Recording:
        first, second = recording.tracks
        exchanged = (replace(first, s=second.s), replace(second, s=first.s))
        return replace(recording, tracks=exchanged)

    for recording in measured.recordings:
        lengths = {track.s for track in recording.tracks}
        if len(recording.tracks) != 2 or len(lengths) != 2 or None in lengths:
            return None
    return measured.with_recordings(exchange)


DIRECTIONS = (
    Correction(
        table="points",
        field="y",
        statement="y points down, not up",
        remedy="Multiply y by -1",
        undo=partial(map_points, matrix=np.diag([1.0, -1.0])),
        kind="y_down",
    ),
    Correction(
        table="points",
        field="x",
        statement="x points to the left, not to the right",
        remedy="Multiply x by -1",
        undo=partial(map_points, matrix=np.diag([-1.0, 1.0])),
        kind="x_left",
    ),
    Correction(
        table="points",
        field="x, y",
        statement="x and y have changed places",
        remedy="Exchange the two columns",
        undo=partial(map_points, matrix=np.array([[0.0, 1.0], [1.0, 0.0]])),
        kind="exchange_axes",
    ),
    Correction(
        table="grasp",
        field="y, theta",
        statement="y of the hand and of the points points down, not up",
        remedy="Multiply y of both by -1, and theta too",
        undo=mirror_world,
        kind="mirror",
    ),
)
ARC_LENGTHS = (
    Correction(
        table="points",
        field="s",
        statement="arc lengths are counted from the tip, not from the grasp",
        remedy="Replace s by string.length - s",
        undo=reverse_arc_lengths,
        kind="reverse_s",
    ),
    Correction(
        table=DATASET_FILE,
        field="string.length",
        statement="the string ends at its last point, and is not as long as stated",
        remedy="Correct s or string.length",
        undo=end_at_last_point,
        kind="end",
    ),
    Correction(
        table="points",
        field="s",
        statement="the two points have changed places along the string",
        remedy="Exchange their s",
        undo=exchange_arc_lengths,
        kind="exchange_s",
    ),
)

# --- joint angles ------------------------------------------------------------


def change_joints(
    measured: Measurements, change: Callable[[np.ndarray], np.ndarray]
) -> Measurements | None:
    """Change joint angles (K, J); None if there are none."""
    if not measured.has_joints:
        return None

    def change_recording(recording: Recording) -> Recording:
        if recording.joints is None:
            return recording
        return replace(recording, joints=change(recording.joints))

    return measured.with_recordings(change_recording)


def take_columns(joints: np.ndarray, order: tuple[int, ...]) -> np.ndarray:
    """Return the columns of joint angles (K, J) in an order."""
    return joints[:, list(order)]


def relative_angles(joints: np.ndarray) -> np.ndarray:
    """Return angles to the link before from angles to +x."""
    return np.diff(joints, axis=1, prepend=0.0)


def counts_to_radians(counts: np.ndarray, zero: float) -> np.ndarray:
    """Return angles of an encoder's counts that wrap after a turn."""
    return np.unwrap((counts - zero) * 2 * np.pi / COUNTS_PER_TURN, axis=0)


def undo_counts(measured: Measurements, zero: float) -> Measurements | None:
    """Take joint angles as counts of an encoder; None if they cannot be.

    A reader may have taken such large numbers for degrees already.
    """
    largest = 0.0
    for recording in measured.recordings:
        if recording.joints is not None:
            largest = max(largest, float(np.abs(recording.joints).max()))
    factor = 1.0 if largest > MIN_COUNT else 180 / np.pi
    if not MIN_COUNT < largest * factor <= 2 * COUNTS_PER_TURN:
        return None
    return change_joints(
        measured, lambda joints: counts_to_radians(joints * factor, zero)
    )


def joint_corrections(count: int) -> Iterator[Correction]:
    """Yield corrections of the angles of so many joints."""
    names = [f"q{number + 1}" for number in range(count)]
    field = ", ".join(names)
    yield Correction(
        table="arm",
        field=field,
        statement="angles are in degrees, not in radians",
        remedy="Multiply them by pi / 180",
        undo=partial(change_joints, change=np.radians),
        kind="degrees",
    )
    for zero in (0, COUNTS_PER_TURN // 2):
        yield Correction(
            table="arm",
            field=field,
            statement=(
                f"angles are an encoder's counts, {COUNTS_PER_TURN} a turn, from {zero}"
            ),
            remedy=(
                f"Subtract {zero}, multiply them by 2 pi / {COUNTS_PER_TURN} and unwrap"
            ),
            undo=partial(undo_counts, zero=zero),
            kind="counts",
            zero=zero,
        )
    yield Correction(
        table="arm",
        field=field,
        statement="angles are those of the links to +x, not to the link before",
        remedy="Subtract from each the one before",
        undo=partial(change_joints, change=relative_angles),
        kind="absolute",
    )
    for order in joint_orders(count):
        new = ", ".join(names[number] for number in order)
        yield Correction(
            table="arm",
            field=field,
            statement=f"joints are in another order: what is called {new} is {field}",
            remedy="Rename the columns",
            undo=partial(change_joints, change=partial(take_columns, order=order)),
            kind="joint_order",
            order=order,
        )


def joint_orders(count: int) -> list[tuple[int, ...]]:
    """Return the wrong orders of joints that are tried."""
    usual = tuple(range(count))
    if count <= MAX_PERMUTED_JOINTS:
        return [order for order in permutations(usual) if order != usual]
    orders = []
    for first in range(count - 1):
        order = list(usual)
        order[first], order[first + 1] = order[first + 1], order[first]
        orders.append(tuple(order))
    return [*orders, usual[::-1]]


# --- rates -------------------------------------------------------------------


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
    scaled = measured.with_tracks(lambda track: replace(track, t=factor * track.t))
    return scaled.with_recordings(
        lambda recording: replace(recording, t=factor * recording.t)
    )


def rate_correction(factor: float, words: str) -> Correction:
    """Return the correction of another frame rate than that of the arm's clock."""
    return Correction(
        table="points",
        field="t",
        statement=f"times of the points run {words}",
        remedy=f"Multiply t, since the beginning of each trial, by {factor:g}: "
        "the frame rate was another",
        undo=partial(scale_point_times, factor=factor),
        kind="rate",
        factor=factor,
    )


def pace_correction(factor: float, words: str) -> Correction:
    """Return the correction of slow motion, or of other ticks, on both clocks."""
    return Correction(
        table="arm, points",
        field="t",
        statement=f"hand and string move at {words} the pace of a string that falls",
        remedy=(
            f"Multiply t of both by {factor:g}: it is slow motion, or in another unit"
        ),
        undo=partial(scale_all_times, factor=factor),
        kind="pace",
        factor=factor,
    )


RATES = (
    rate_correction(0.5, "half as fast as the arm's"),
    rate_correction(2.0, "twice as fast as the arm's"),
)
PACES = (
    pace_correction(0.125, "an eighth of"),
    pace_correction(0.25, "a quarter of"),
    pace_correction(0.5, "half"),
    pace_correction(2.0, "twice"),
    pace_correction(4.0, "four times"),
    pace_correction(8.0, "eight times"),
)


def single_corrections(
    measured: Measurements, camera: Camera | None
) -> list[Correction]:
    """Return all corrections that can be tried on measurements."""
    corrections = [
        *unit_corrections(),
        *ratio_corrections(),
        *ARC_LENGTHS,
        *DIRECTIONS,
        *RATES,
        *PACES,
    ]
    if camera is not None:
        corrections.append(pixel_correction(camera))
    counts = {r.joints.shape[1] for r in measured.recordings if r.joints is not None}
    for count in counts:
        corrections += joint_corrections(count)
    return corrections


def apply_corrections(
    measured: Measurements, corrections: Iterable[Correction]
) -> Measurements | None:
    """Undo mistakes one after another; None if one of them cannot be there."""
    for correction in corrections:
        corrected = correction.undo(measured)
        if corrected is None:
            return None
        measured = corrected
    return measured
