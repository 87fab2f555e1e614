"""Joint angles in another unit, convention or order."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np

from stringcast.data.importers.reader import COUNTS_PER_TURN
from stringcast.stages.check.consistency.corrections.base import Correction
from stringcast.stages.check.consistency.record import Measurements, Recording

MAX_PERMUTED_JOINTS = 3  # if there are more, only neighbours are exchanged
QUARTER_TURNS = (0, 90, -90, 180)  # [degrees] between usual zeros of a joint
MIN_COUNT = 100.0  # least maximum of joint angles that are counts


@dataclass(frozen=True, kw_only=True)
class Degrees(Correction):
    """Joint angles are in degrees."""

    table = "arm"
    field: str
    statement = "angles are in degrees, not in radians"
    remedy = "Multiply them by pi / 180"

    def undo(self, measured: Measurements) -> Measurements | None:
        return change_joints(measured, np.radians)


@dataclass(frozen=True, kw_only=True)
class Radians(Correction):
    """Joint angles in radians were converted as if they were in degrees."""

    table = "arm"
    field: str
    statement = "angles were in radians already, not in degrees"
    remedy = "Multiply them by 180 / pi"

    def undo(self, measured: Measurements) -> Measurements | None:
        return change_joints(measured, np.degrees)


@dataclass(frozen=True, kw_only=True)
class JointConvention(Correction):
    """Joints have other signs or zeros.

    signs: 1 or -1 for each joint. zeros: to be added then [degrees].
    """

    table = "arm"
    field: str
    statement: str
    remedy = "Change the columns so"
    signs: tuple[int, ...]
    zeros: tuple[int, ...]

    def undo(self, measured: Measurements) -> Measurements | None:
        zeros = np.radians(self.zeros)
        return change_joints(measured, lambda joints: joints * self.signs + zeros)


@dataclass(frozen=True, kw_only=True)
class EncoderCounts(Correction):
    """Joint angles are counts of an encoder, which are `zero` at angle 0.

    A reader may have converted such large numbers from degrees.
    """

    table = "arm"
    field: str
    statement: str
    remedy: str
    zero: int

    def undo(self, measured: Measurements) -> Measurements | None:
        largest = 0.0
        for recording in measured.recordings:
            if recording.joints is not None:
                largest = max(largest, float(np.abs(recording.joints).max()))
        factor = 1.0 if largest > MIN_COUNT else 180 / np.pi
        if not MIN_COUNT < largest * factor <= 2 * COUNTS_PER_TURN:
            return None

        def convert(joints: np.ndarray) -> np.ndarray:
            turns = (joints * factor - self.zero) / COUNTS_PER_TURN
            return np.unwrap(2 * np.pi * turns, axis=0)  # counts wrap after a turn

        return change_joints(measured, convert)


@dataclass(frozen=True, kw_only=True)
class AbsoluteAngles(Correction):
    """Joint angles are those of the links to +x."""

    table = "arm"
    field: str
    statement = "angles are those of the links to +x, not to the link before"
    remedy = "Subtract from each the one before"

    def undo(self, measured: Measurements) -> Measurements | None:
        def subtract_link_before(joints: np.ndarray) -> np.ndarray:
            return np.diff(joints, axis=1, prepend=0.0)

        return change_joints(measured, subtract_link_before)


@dataclass(frozen=True, kw_only=True)
class JointOrder(Correction):
    """Joints are in another order.

    order: indices of the columns in the right order.
    """

    table = "arm"
    field: str
    statement: str
    remedy = "Rename the columns"
    order: tuple[int, ...]

    def undo(self, measured: Measurements) -> Measurements | None:
        return change_joints(measured, lambda joints: joints[:, list(self.order)])


def joint_corrections(count: int) -> Iterator[Correction]:
    """Yield corrections of the angles of a number of joints."""
    names = [f"q{number + 1}" for number in range(count)]
    field = ", ".join(names)
    yield Degrees(field=field)
    yield Radians(field=field)
    for zero in (0, COUNTS_PER_TURN // 2):
        yield EncoderCounts(
            field=field,
            statement=(
                f"angles are an encoder's counts, {COUNTS_PER_TURN} a turn, from {zero}"
            ),
            remedy=(
                f"Subtract {zero}, multiply them by 2 pi / {COUNTS_PER_TURN} and unwrap"
            ),
            zero=zero,
        )
    yield AbsoluteAngles(field=field)
    for order in joint_orders(count):
        new = ", ".join(names[number] for number in order)
        statement = f"joints are in another order: what is called {new} is {field}"
        yield JointOrder(field=field, statement=statement, order=order)


def joint_conventions(measured: Measurements) -> Iterator[JointConvention]:
    """Yield other signs and zeros of joints, in quarter turns."""
    counts = {r.joints.shape[1] for r in measured.recordings if r.joints is not None}
    if len(counts) != 1 or max(counts) > MAX_PERMUTED_JOINTS:
        return
    (count,) = counts
    names = [f"q{number + 1}" for number in range(count)]
    for signs in product((1, -1), repeat=count):
        for zeros in product(QUARTER_TURNS, repeat=count):
            changes = []
            for name, sign, zero in zip(names, signs, zeros, strict=True):
                if sign < 0 or zero:
                    shift = f" {'-' if zero < 0 else '+'} {abs(zero)} degrees"
                    right = f"{'-' if sign < 0 else ''}{name}{shift if zero else ''}"
                    changes.append(f"{name} is {right}")
            if changes:
                yield JointConvention(
                    field=", ".join(names),
                    statement=f"signs or zeros of joints: {', '.join(changes)}",
                    signs=signs,
                    zeros=zeros,
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
