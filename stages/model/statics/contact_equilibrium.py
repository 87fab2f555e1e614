"""Static equilibrium where forces depend on the place, as in contact.

A hard contact yields less than a segment stretches, so angles phi and lengths l are
solved for together. With n_j, t_j a segment's normal and tangent, F_j the force beyond
it, T its tension,

    M_{j+1} - M_j + l_j n_j . F_j = 0,    t_j . F_j - T(l_j) = 0.

The left sides are minus the gradient of an energy. A Newton step is limited to the part
along which the energy falls. Otherwise a string could alternate between touching and
not touching forever.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from stringcast.stages.model.polyline import turn_left
from stringcast.stages.model.statics.chain import (
    ANGLE_TOLERANCE_RAD,
    MAX_ITERATIONS,
    MAX_TURN_RAD,
    MIN_TURN_STIFFNESS,
    Chain,
    guess_angles,
    hinge_moments,
    slot_sum_and_slope,
    static_point_forces,
    sum_to_tip,
    tangents_and_positions,
)
from stringcast.stages.model.string import String

MAX_STEP_REDUCTIONS = 12
# Largest slope of the energy at the end of a step, relative to that at its beginning.
MAX_END_SLOPE_SHARE = 0.5
# [m], small because a hard contact is entered only a little
FORCE_DIFFERENCE_STEP_M = 1e-9
DIFFERENCE_DIRECTIONS = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))


def contact_shape(
    string: String, material: np.ndarray, pose: np.ndarray, turn: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Find the static equilibrium of strings in contact.

    Parameters
    ----------
    string : String
        The string and its effects.
    material : ndarray of shape (C, P)
        Material properties, as `String.material`.
    pose : ndarray of shape (C, 3)
        Pose of the grasp [m], [m], [rad].
    turn : ndarray of shape (C,)
        As in `equilibrium.hanging_shape` [rad].

    Returns
    -------
    angles, lengths : ndarray of shape (C, n - 1)
        Angles of the segments, unwrapped from the grasp [rad], and lengths [m].
    """
    chain = Chain.from_material(string, material)
    angles = guess_angles(chain, pose[:, 2], turn)
    strings = _RelaxingStrings(chain, pose, angles, chain.rest_lengths)
    moving = np.arange(len(material))
    for _ in range(MAX_ITERATIONS):
        moving_strings = strings.for_candidates(moving)
        step = moving_strings.newton_step
        fraction = _step_fraction(moving_strings, step)
        strings = strings.with_step(moving, fraction[:, None] * step)
        # Each candidate stops independently, so its shape does not depend on others.
        largest_turn = np.abs(step[:, : angles.shape[1]]).max(axis=1)
        moving = moving[largest_turn > ANGLE_TOLERANCE_RAD]
        if moving.size == 0:
            break
    return strings.angles, strings.lengths


def _step_fraction(strings: _RelaxingStrings, step: np.ndarray) -> np.ndarray:
    """Choose how much of a step (C, 2 n - 2) to take, (C,).

    It is as much as MAX_TURN_RAD allows. If the energy rises steeply at the end of that
    step, the Illinois variant of false position (Dowell and Jarratt 1971, BIT 11, 168)
    finds where the energy is nearly flat: it halves the slope at an end of the bracket
    that stays.
    """
    largest_turn = np.abs(step[:, : strings.angles.shape[1]]).max(axis=1)
    fraction = np.minimum(1.0, MAX_TURN_RAD / np.maximum(largest_turn, 1e-300))
    fall_before = np.sum(strings.residual * step, axis=1)
    fall_after = _energy_fall_rate(strings, step, fraction)
    flat = MAX_END_SLOPE_SHARE * fall_before
    searching = np.flatnonzero((fall_after < -flat) & (flat > 0))

    bracket = np.stack([0 * fraction, fraction])  # (2, C): energy falls, rises
    falls = np.stack([fall_before, fall_after])
    for _ in range(MAX_STEP_REDUCTIONS):
        if searching.size == 0:
            break
        low, high = bracket[:, searching]
        fall_low, fall_high = falls[:, searching]
        # The limits keep it off the ends, where it would not move.
        share = np.clip(fall_low / (fall_low - fall_high), 0.02, 0.98)
        middle = low + (high - low) * share
        fall = _energy_fall_rate(
            strings.for_candidates(searching), step[searching], middle
        )
        end = (fall <= 0).astype(int)
        bracket[end, searching] = middle
        falls[end, searching] = fall
        falls[1 - end, searching] /= 2
        fraction[searching] = middle
        searching = searching[np.abs(fall) > flat[searching]]
    return fraction


def _energy_fall_rate(
    strings: _RelaxingStrings, step: np.ndarray, fraction: np.ndarray
) -> np.ndarray:
    """Find the negative slope of the energy along a step, at a fraction of it, (C,)."""
    moved = strings.with_step(np.arange(len(step)), fraction[:, None] * step)
    return np.sum(moved.residual * step, axis=1)


@dataclass(frozen=True)
class _RelaxingStrings:
    """Iterate of the search for static equilibrium.

    pose: (C, 3). angles [rad], lengths [m]: (C, n - 1).
    """

    chain: Chain
    pose: np.ndarray
    angles: np.ndarray
    lengths: np.ndarray

    def for_candidates(self, candidates: np.ndarray) -> _RelaxingStrings:
        return _RelaxingStrings(
            self.chain.for_candidates(candidates),
            self.pose[candidates],
            self.angles[candidates],
            self.lengths[candidates],
        )

    def with_step(self, candidates: np.ndarray, step: np.ndarray) -> _RelaxingStrings:
        """Turn and stretch the strings in `candidates`.

        step: (K, 2 n - 2), angles first [rad], then lengths [m].
        """
        angles, lengths = self.angles.copy(), self.lengths.copy()
        angles[candidates] += step[:, : angles.shape[1]]
        lengths[candidates] += step[:, angles.shape[1] :]
        return replace(self, angles=angles, lengths=lengths)

    @cached_property
    def tangents_and_positions(self) -> tuple[np.ndarray, np.ndarray]:
        """Tangents of segments and positions of free points, (C, n - 1, 2) each."""
        return tangents_and_positions(self.pose, self.angles, self.lengths)

    @property
    def tangent(self) -> np.ndarray:
        """Tangents of the segments, (C, n - 1, 2)."""
        return self.tangents_and_positions[0]

    @cached_property
    def normal(self) -> np.ndarray:
        """Normals of the segments, (C, n - 1, 2)."""
        return turn_left(self.tangent)

    @cached_property
    def force(self) -> np.ndarray:
        """Force beyond each segment, F, (C, n - 1, 2)."""
        tangent, positions = self.tangents_and_positions
        return sum_to_tip(static_point_forces(self.chain, positions, tangent))

    @property
    def force_along(self) -> np.ndarray:
        """Component of the force along the segment, (C, n - 1)."""
        return np.sum(self.force * self.tangent, axis=-1)

    @property
    def force_across(self) -> np.ndarray:
        """Component of the force across the segment, (C, n - 1)."""
        return np.sum(self.force * self.normal, axis=-1)

    @cached_property
    def moments(self) -> tuple[np.ndarray, np.ndarray]:
        """Moments at the hinges and their slopes with the angle, (C, n) each."""
        return hinge_moments(self.chain, self.pose[:, 2], self.angles)

    @cached_property
    def tension(self) -> tuple[np.ndarray, np.ndarray]:
        """Tension [m2/s2] and its slope with the stretch, (C, n - 1) each."""
        stretch = self.lengths / self.chain.segment_length - 1
        return slot_sum_and_slope(
            self.chain.string, self.chain.material, "tension", stretch
        )

    @cached_property
    def residual(self) -> np.ndarray:
        """Residual of the balances of moments and of tensions, (C, 2 n - 2)."""
        moment, _ = self.moments
        differences = moment[:, 1:] - moment[:, :-1]
        turning = differences + self.lengths * self.force_across
        pulling = self.force_along - self.tension[0]
        return np.concatenate([turning, pulling], axis=1)

    @property
    def newton_step(self) -> np.ndarray:
        """Newton step, (C, 2 n - 2): turns [rad], then changes of length [m].

        If the matrix is not positive definite, destabilising forces are left out, so
        that the step does not lead to a saddle point of the energy.
        """
        position_stiffness = self._position_stiffness()
        along = self.lengths * self.force_along
        across = self.force_across
        matrix = self._local_matrix(along, across) - position_stiffness
        is_stable = np.array([_is_positive_definite(block) for block in matrix])
        if not is_stable.all():
            stabilising = np.maximum(along, MIN_TURN_STIFFNESS)
            stable = self._local_matrix(stabilising, np.zeros_like(across))
            stable -= position_stiffness
            matrix = np.where(is_stable[:, None, None], matrix, stable)
        return np.linalg.solve(matrix, self.residual[..., None])[..., 0]

    def _local_matrix(self, along: np.ndarray, across: np.ndarray) -> np.ndarray:
        """Assemble the matrix of the balances without forces that depend on the place.

        It is (C, 2 n - 2, 2 n - 2). along, across: components of the forces, (C, n -
        1).
        """
        count = self.angles.shape[1]
        _, stiffness = self.moments
        matrix = np.zeros((len(self.angles), 2 * count, 2 * count))
        turns, stretches = np.arange(count), np.arange(count, 2 * count)
        matrix[:, turns, turns] = stiffness[:, :-1] + stiffness[:, 1:] + along
        # A hinge couples the segments on both sides.
        coupling = -stiffness[:, 1:-1]
        matrix[:, turns[1:], turns[:-1]] = coupling
        matrix[:, turns[:-1], turns[1:]] = coupling
        tension_per_length = self.tension[1] / self.chain.segment_length
        matrix[:, stretches, stretches] = tension_per_length
        matrix[:, turns, stretches] = matrix[:, stretches, turns] = -across
        return matrix

    def _position_stiffness(self) -> np.ndarray:
        """Find the derivative of the balances by forces that depend on the place.

        It is (C, 2 n - 2, 2 n - 2). Turning or stretching segment m moves all points
        beyond it by l_m n_m or t_m. With K the derivative of a point's force with
        respect to its place, the balance of segment j changes by l_j n_j . (sum of K
        beyond both) l_m n_m, and likewise for stretches.
        """
        tangent, positions = self.tangents_and_positions
        count, segments = self.angles.shape
        offsets = FORCE_DIFFERENCE_STEP_M * np.array(DIFFERENCE_DIRECTIONS)
        moved = np.concatenate([positions + offset for offset in offsets])
        moved_chain = self.chain.for_candidates(np.tile(np.arange(count), 4))
        forces = static_point_forces(moved_chain, moved, np.tile(tangent, (4, 1, 1)))
        above, below = forces.reshape(2, 2, *positions.shape)
        slope = (above - below) / (2 * FORCE_DIFFERENCE_STEP_M)
        force_per_move = np.moveaxis(slope, 0, -1)  # K, (C, n - 1, 2, 2)

        number = np.arange(segments)
        farther = np.maximum.outer(number, number)  # the farther of two segments
        beyond_both = sum_to_tip(force_per_move)[:, farther]
        moves = (self.lengths[..., None] * self.normal, tangent)
        blocks = []
        for row in moves:
            blocks.append(
                [np.einsum("cja,cjmab,cmb->cjm", row, beyond_both, m) for m in moves]
            )
        return np.block(blocks)


def _is_positive_definite(matrix: np.ndarray) -> bool:
    """Return whether a symmetric matrix is positive definite."""
    try:
        np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        return False
    return True
