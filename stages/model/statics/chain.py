"""Statics of a string: forces and moments at rest, and their derivatives.

The unknowns are the angles phi [rad] (unwrapped from the grasp) and lengths l [m] of
the segments, (C, n - 1) each. The string hangs from a pose (C, 3) of the grasp. Forces
are divided by the nominal mass per length [m^2/s^2].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stringcast.stages.common import GRAVITY_M_S2
from stringcast.stages.model.engine.stability import (
    SAMPLED_ARGUMENTS,
    load_sum,
    slot_sum,
    vector_slot_sum,
)
from stringcast.stages.model.string import String

MAX_ITERATIONS = 200  # Newton steps
MAX_TURN_RAD = 0.3  # of a segment in one iteration
# [m3/s2], so that the matrix of a string without stiffness is not singular
MIN_TURN_STIFFNESS = 1e-9
ANGLE_TOLERANCE_RAD = 1e-12  # largest change of an angle at convergence

ZERO = np.zeros((1, 1))


@dataclass(frozen=True)
class Chain:
    """Strings and their properties that do not change during the iteration.

    They are computed once, because that takes longer than an iteration.

    Parameters
    ----------
    string : String
    material : ndarray of shape (C, rows)
    segment_length : ndarray of shape (C, 1)
        Rest length of a segment [m].
    arc_lengths : ndarray of shape (C, n)
        Arc lengths of the points along the free string [m].
    masses, cells : ndarray of shape (C, n)
        As `String.point_masses` [m].
    rest_curvature : ndarray of shape (C, n - 2)
        Curvature of the hinges at rest [1/m].
    rest_grasp_angle : ndarray of shape (C, 1)
        Angle of the hinge at the grasp at rest [rad].
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
        """Return the chains for candidates' material (C, rows)."""
        arc_lengths = string.free_arc_lengths(material)
        masses, cells = string.point_masses(material)
        return cls(
            string,
            material,
            string.free_segment_lengths(material)[:, None],
            arc_lengths,
            masses,
            cells,
            _rest_curvature(string, material, arc_lengths[:, 1:-1]),
            grasp_rest_angle(string, material),
        )

    @property
    def rest_lengths(self) -> np.ndarray:
        """Rest lengths of the segments, (C, n - 1) [m]."""
        return np.repeat(self.segment_length, self.string.points - 1, axis=1)

    def for_candidates(self, candidates: np.ndarray) -> Chain:
        """Return the chains of some candidates, by number."""
        return Chain(
            self.string,
            self.material[candidates],
            self.segment_length[candidates],
            self.arc_lengths[candidates],
            self.masses[candidates],
            self.cells[candidates],
            self.rest_curvature[candidates],
            self.rest_grasp_angle[candidates],
        )


def guess_angles(chain: Chain, theta: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Guess the angles of the segments, (C, n - 1) [rad].

    The string turns from the grasp's direction to straight down, over the length on
    which its weight bends a rod.

    theta: direction of the grasp, (C,) [rad]. turn: approximate turn of the string,
    (C,) [rad], which selects one of the two directions.
    """
    string, material = chain.string, chain.material
    _, stiffness = slot_sum_and_slope(string, material, "moment", ZERO)
    bending_length = (np.maximum(stiffness, 1e-12) / GRAVITY_M_S2) ** (1 / 3)

    down = -np.pi / 2
    shorter = (down - theta + np.pi) % (2 * np.pi) - np.pi
    longer = shorter - 2 * np.pi * np.sign(shorter)
    longer_is_nearer = np.abs(turn - longer) < np.abs(turn - shorter)
    fall = np.where(longer_is_nearer, longer, shorter)

    middles = string.segment_middles() * string.free_length_ratio(material)[:, None]
    share = 1 - np.exp(-middles / bending_length)
    return theta[:, None] + fall[:, None] * share


def forces_beyond_segments(
    chain: Chain, pose: np.ndarray, angles: np.ndarray, lengths: np.ndarray
) -> np.ndarray:
    """Sum the forces on points beyond a segment's start, (C, n - 1, 2) [m^2/s^2]."""
    tangent, positions = tangents_and_positions(pose, angles, lengths)
    return sum_to_tip(static_point_forces(chain, positions, tangent))


def tangents_and_positions(
    pose: np.ndarray, angles: np.ndarray, lengths: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Find segments' directions and free points' positions, (C, n - 1, 2) each.

    pose: pose of the grasp, (C, 3). angles [rad], lengths [m]: (C, n - 1).
    """
    tangent = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    from_grasp = np.cumsum(lengths[..., None] * tangent, axis=1)
    return tangent, pose[:, None, :2] + from_grasp


def static_point_forces(
    chain: Chain, positions: np.ndarray, tangent: np.ndarray
) -> np.ndarray:
    """Find the force on each free point at rest, (C, n - 1, 2) [m^2/s^2]."""
    string, material = chain.string, chain.material
    place = {"x": positions[..., 0], "y": positions[..., 1]}
    direction = {"tx": tangent[..., 0], "ty": tangent[..., 1]}
    arguments = {**place, **direction, "s": chain.arc_lengths[:, 1:]}
    loads = load_sum(string, material, arguments)
    fall = vector_slot_sum(string, material, "acceleration", {**place, "t": ZERO})
    return loads * chain.cells[:, 1:, None] + fall * chain.masses[:, 1:, None]


def sum_to_tip(values: np.ndarray) -> np.ndarray:
    """Sum values (C, n - 1, ...) from each point to the tip."""
    return np.cumsum(values[:, ::-1], axis=1)[:, ::-1]


def hinge_moments(
    chain: Chain, theta: np.ndarray, angles: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Find moments at the hinges and their slope with the hinge angle, (C, n) each.

    Both are 0 at the free end.
    """
    string, material = chain.string, chain.material
    grasp, grasp_slope = slot_sum_and_slope(
        string, material, "grasp_moment", grasp_hinge_angle(chain, theta, angles)
    )
    inner, inner_slope = slot_sum_and_slope(
        string,
        material,
        "moment",
        hinge_curvatures(chain, angles),
        s=chain.arc_lengths[:, 1:-1],
    )
    end = np.zeros((len(material), 1))
    moments = np.concatenate([grasp, inner, end], axis=1)
    per_angle = inner_slope / chain.segment_length
    return moments, np.concatenate([grasp_slope, per_angle, end], axis=1)


def hinge_curvatures(chain: Chain, angles: np.ndarray) -> np.ndarray:
    """Find the curvatures of the hinges minus those at rest, (C, n - 2) [1/m].

    angles: angles of the segments, (C, n - 1) [rad].
    """
    turns = angles[:, 1:] - angles[:, :-1]
    return turns / chain.segment_length - chain.rest_curvature


def grasp_hinge_angle(
    chain: Chain, theta: np.ndarray, angles: np.ndarray
) -> np.ndarray:
    """Find the angle of the hinge at the grasp minus that at rest, (C, 1) [rad].

    theta: direction of the hand, (1 or C,) [rad]. angles: angles of the segments,
    (C, n - 1) [rad].
    """
    return angles[:, :1] - theta[:, None] - chain.rest_grasp_angle


def grasp_rest_angle(string: String, material: np.ndarray) -> np.ndarray:
    """Find the angle of the hinge at the grasp at rest, (C, 1) [rad].

    It comes from the hinge's share of the first segment's curvature.
    """
    share = string.grasp_cell * string.free_segment_lengths(material)[:, None]
    return share * _rest_curvature(string, material, ZERO)


def grasp_compliance_length(string: String, material: np.ndarray) -> np.ndarray:
    """Find the length of string with the grasp's compliance, (C,) [m]."""
    _, bending = slot_sum_and_slope(string, material, "moment", ZERO)
    _, grasp = slot_sum_and_slope(string, material, "grasp_moment", ZERO)
    ratio = bending / np.maximum(grasp, MIN_TURN_STIFFNESS)
    return ratio[:, 0]


def _rest_curvature(string: String, material: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Find the curvature at rest at arc lengths s (1 or C, M) [m], (C, M) [1/m]."""
    length = string.length * string.free_length_ratio(material)[:, None]
    return slot_sum(string, material, "rest_curvature", {"s": s, "length": length})


def slot_sum_and_slope(
    string: String,
    material: np.ndarray,
    slot: str,
    values: np.ndarray,
    **others: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Sum a slot's laws at rest, and find the slope with its first argument.

    Both are (C, M). One call evaluates the laws, because calls take most of the time
    with so few numbers.

    values: the slot's first argument (stretch, curvature or angle), (1 or C, M).
    others: further arguments, (1 or C, M) each.
    """
    (argument, _), _ = SAMPLED_ARGUMENTS[slot]
    step = 1e-3 if argument == "curvature" else 1e-5
    count = values.shape[1]
    samples = np.concatenate([values, values + step, values - step], axis=1)
    arguments = {argument: samples, "rate": ZERO}
    for name, value in others.items():
        arguments[name] = np.tile(value, 3)
    total = slot_sum(string, material, slot, arguments)
    above, below = total[:, count : 2 * count], total[:, 2 * count :]
    return total[:, :count], (above - below) / (2 * step)
