"""Statics of a string: forces and moments at rest, and their derivatives, for the
solvers of its equilibrium.

A string is here the angles phi [rad] (continuous from the grasp) and lengths l [m] of
its segments, (C, n - 1) each, and hangs from a pose (C, 3) of the grasp. Forces are
over the nominal mass per length [m^2/s^2].
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from stringcast.stages.model.engine.stability import load_sum, slot_sum, vector_slot_sum
from stringcast.stages.model.string import String

GRAVITY_M_S2 = 9.81  # [m/s2]
MAX_ITERATIONS = 200  # Newton steps at most
MAX_TURN_RAD = 0.3  # [rad] of a segment in one iteration
# [m3/s2] of what resists a turn, so that a string without stiffness can be turned
MIN_TURN_STIFFNESS = 1e-9
ANGLE_TOLERANCE_RAD = 1e-12  # [rad] change of an angle that ends the iteration


@dataclass(frozen=True)
class Chain:
    """Strings, and what of them stays as it is while they turn and stretch: to find it
    takes longer than a turn.

    material: (C, rows). segment: (C, 1) rest length of a segment [m]. s: (C, n) arc
    lengths of the points from where the free string begins [m]. masses, cells: (C, n),
    as `String.masses`. curved: (C, n - 2) curvature at rest of the hinges [1/m],
    turned: (C, 1) angle at rest of that at the grasp [rad].
    """

    string: String
    material: np.ndarray
    segment_length: np.ndarray
    arc_lengths: np.ndarray
    masses: np.ndarray
    cells: np.ndarray
    rest_curvature: np.ndarray
    rest_grasp_angle: np.ndarray

    @classmethod
    def from_material(cls, string: String, material: np.ndarray) -> Chain:
        """The chains at rest of candidates' material (C, rows)."""
        segment, s = (
            string.free_segment_lengths(material)[:, None],
            string.free_arc_lengths(material),
        )
        curved = _rest_curvature(string, material, s[:, 1:-1])
        return cls(
            string,
            material,
            segment,
            s,
            *string.point_masses(material),
            curved,
            grasp_rest_angle(string, material),
        )

    def for_candidates(self, which: np.ndarray) -> Chain:
        """The chains of some candidates, by number."""
        parts = (
            self.material,
            self.segment_length,
            self.arc_lengths,
            self.masses,
            self.cells,
            self.rest_curvature,
            self.rest_grasp_angle,
        )
        return Chain(self.string, *(part[which] for part in parts))


def guess_angles(
    string: String, material: np.ndarray, theta: np.ndarray, turn: np.ndarray
) -> np.ndarray:
    """A first guess: from the grasp's direction to straight down, over the length on
    which weight bends the rod, the shorter way or the other, whichever is nearer to a
    turn [rad]. theta, turn: (C,).
    """
    zero = np.zeros((1, 1))
    _, stiffness = slot_sum_and_slope(
        string, material, "moment", "curvature", zero, {"rate": zero}
    )
    scale = (np.maximum(stiffness, 1e-12) / GRAVITY_M_S2) ** (1 / 3)
    shorter = (-np.pi / 2 - theta + np.pi) % (2 * np.pi) - np.pi
    other = shorter - 2 * np.pi * np.sign(shorter)
    fall = np.where(np.abs(turn - other) < np.abs(turn - shorter), other, shorter)
    middles = string.segment_middles() * string.free_length_ratio(material)[:, None]
    return theta[:, None] + fall[:, None] * (1 - np.exp(-middles / scale))


def rest_lengths(string: String, material: np.ndarray) -> np.ndarray:
    """Rest lengths of the segments, (C, n - 1) [m]."""
    return np.repeat(
        string.free_segment_lengths(material)[:, None], string.points - 1, axis=1
    )


def forces_beyond_segments(
    chain: Chain, pose: np.ndarray, angles: np.ndarray, lengths: np.ndarray
) -> np.ndarray:
    """Force over nominal mass per length on the part beyond the start of each segment,
    (C, n - 1, 2) [m^2/s^2].
    """
    tangent, places = tangents_and_positions(pose, angles, lengths)
    return sum_to_tip(static_point_forces(chain, places, tangent))


def tangents_and_positions(
    pose: np.ndarray, angles: np.ndarray, lengths: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Directions of the segments and places of the free points [m], (C, n - 1, 2) each.
    pose: (C, 3) of the grasp. angles [rad], lengths [m]: (C, n - 1).
    """
    tangent = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return tangent, pose[:, None, :2] + np.cumsum(lengths[..., None] * tangent, axis=1)


def static_point_forces(
    chain: Chain, places: np.ndarray, tangent: np.ndarray
) -> np.ndarray:
    """Force over nominal mass per length on each free point at rest, (C, n - 1, 2)
    [m^2/s^2].
    """
    of, place = (
        (chain.string, chain.material),
        {"x": places[..., 0], "y": places[..., 1]},
    )
    pull = load_sum(
        *of,
        {
            **place,
            "tx": tangent[..., 0],
            "ty": tangent[..., 1],
            "s": chain.arc_lengths[:, 1:],
        },
    )
    fall = vector_slot_sum(*of, "acceleration", {**place, "t": np.zeros((1, 1))})
    return pull * chain.cells[:, 1:, None] + fall * chain.masses[:, 1:, None]


def sum_to_tip(each: np.ndarray) -> np.ndarray:
    """Sums over a point and all beyond it. each: (C, n - 1, ...)."""
    return np.cumsum(each[:, ::-1], axis=1)[:, ::-1]


def hinge_moments(
    chain: Chain, theta: np.ndarray, angles: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Moments at the hinges and their slope with the hinge angle, (C, n) each; the free
    end has none.
    """
    of, zero = (chain.string, chain.material), np.zeros((1, 1))
    hinge, bend = (
        grasp_hinge_angle(chain, theta, angles),
        hinge_curvatures(chain, angles),
    )
    first, first_slope = slot_sum_and_slope(
        *of, "grasp_moment", "angle", hinge, {"rate": zero}
    )
    others, others_slope = slot_sum_and_slope(
        *of,
        "moment",
        "curvature",
        bend,
        {"rate": zero, "s": chain.arc_lengths[:, 1:-1]},
    )
    end = np.zeros((len(chain.material), 1))
    slopes = [first_slope, others_slope / chain.segment_length, end]
    return np.concatenate([first, others, end], axis=1), np.concatenate(slopes, axis=1)


def hinge_curvatures(chain: Chain, angles: np.ndarray) -> np.ndarray:
    """Curvatures of the hinges beyond those at rest, (C, n - 2) [1/m]. angles: (C, n -
    1) of the segments [rad].
    """
    return (
        angles[:, 1:] - angles[:, :-1]
    ) / chain.segment_length - chain.rest_curvature


def grasp_hinge_angle(
    chain: Chain, theta: np.ndarray, angles: np.ndarray
) -> np.ndarray:
    """Angle of the hinge at the grasp beyond that at rest, (C, 1) [rad]. theta: (1 or
    C,) of the hand. angles: (C, n - 1).
    """
    return angles[:, :1] - theta[:, None] - chain.rest_grasp_angle


def grasp_rest_angle(string: String, material: np.ndarray) -> np.ndarray:
    """Angle at rest of the hinge at the grasp, from its share of the first segment's
    curvature, (C, 1) [rad].
    """
    return (
        string.grasp_cell
        * string.free_segment_lengths(material)[:, None]
        * _rest_curvature(string, material, np.zeros((1, 1)))
    )


def grasp_compliance_length(string: String, material: np.ndarray) -> np.ndarray:
    """Length of string [m] that turns as far as the hinge at the grasp under a moment,
    (C,).
    """
    zero = np.zeros((1, 1))
    _, bending = slot_sum_and_slope(
        string, material, "moment", "curvature", zero, {"rate": zero}
    )
    _, grasp = slot_sum_and_slope(
        string, material, "grasp_moment", "angle", zero, {"rate": zero}
    )
    return (bending / np.maximum(grasp, MIN_TURN_STIFFNESS))[:, 0]


def _rest_curvature(string: String, material: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Curvature at rest at these arc lengths, (C, M) [1/m]. s: (1 or C, M) [m]."""
    length = string.length * string.free_length_ratio(material)[:, None]
    return slot_sum(string, material, "rest_curvature", {"s": s, "length": length})


def slot_sum_and_slope(
    string: String,
    material: np.ndarray,
    slot: str,
    name: str,
    at: np.ndarray,
    others: Mapping[str, np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """Sum of a slot's laws, and its rise with one argument, (C, M) each.

    at: (1 or C, M) of that argument. others: the slot's other arguments, (1, 1 or M)
    each. Asked in one call: with so few numbers it is the calls that take the time.
    """
    step = 1e-3 if name == "curvature" else 1e-5
    count = at.shape[1]
    three = np.concatenate([at, at + step, at - step], axis=1)
    wide = {
        key: np.tile(value, 3) if value.shape[1] > 1 else value
        for key, value in others.items()
    }
    total = slot_sum(string, material, slot, {name: three, **wide})
    return total[:, :count], (total[:, count : 2 * count] - total[:, 2 * count :]) / (
        2 * step
    )
