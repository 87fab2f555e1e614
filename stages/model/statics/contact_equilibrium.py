"""The string at rest where forces depend on the place: it leans on something, or is
pulled.

What is hard pushes back over a shorter way than a segment stretches, so angles phi and
lengths l are sought together. With n_j, t_j a segment's normal and direction, F_j the
force beyond it, T its tension,

    M_{j+1} - M_j + l_j n_j . F_j = 0,    t_j . F_j - T(l_j) = 0.

Their left sides are minus the slopes of an energy, and a Newton step is taken as far as
that falls: a string that goes back and forth between touching and not would do so for
ever.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from stringcast.stages.model.statics.chain import (
    ANGLE_TOLERANCE_RAD,
    MAX_ITERATIONS,
    MAX_TURN_RAD,
    MIN_TURN_STIFFNESS,
    Chain,
    guess_angles,
    hinge_moments,
    rest_lengths,
    slot_sum_and_slope,
    static_point_forces,
    sum_to_tip,
    tangents_and_positions,
)
from stringcast.stages.model.string import String

MAX_STEP_REDUCTIONS = 12  # times that a step is shortened at most
# of the energy's slope where the step begins: so steeply it may rise where it ends
MAX_END_SLOPE_SHARE = 0.5
# [m] over which the change of a force is asked: what is hard is hardly entered
FORCE_DIFFERENCE_STEP_M = 1e-9


def contact_shape(
    string: String, material: np.ndarray, pose: np.ndarray, turn: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Angles [rad] (continuous from the grasp) and lengths [m] of the segments at rest,
    (C, n - 1) each.

    material: (C, P). pose: (C, 3) of the grasp. turn: (C,), as of
    `equilibrium.hanging`.
    """
    angles = guess_angles(string, material, pose[:, 2], turn)
    now = _RelaxingStrings(
        Chain.from_material(string, material),
        pose,
        angles,
        rest_lengths(string, material),
    )
    moving = np.arange(len(material))
    for _ in range(MAX_ITERATIONS):
        some = now.for_candidates(moving)
        step = some.newton_step
        now = now.with_step(moving, _step_fraction(some, step)[:, None] * step)
        # Each candidate ends on its own, so that its shape does not depend on its
        # company.
        moving = moving[
            np.abs(step[:, : angles.shape[1]]).max(axis=1) > ANGLE_TOLERANCE_RAD
        ]
        if moving.size == 0:
            break
    return now.angles, now.lengths


def _step_fraction(here: _RelaxingStrings, step: np.ndarray) -> np.ndarray:
    """How much of a step (C, 2 n - 2) to take, (C,): all of it, or about as far as the
    energy falls.

    Not less either: only a string that touches knows of what it touches. By false
    position, of which each end counts for half as much with every step that it stays.
    """
    turn = np.abs(step[:, : here.angles.shape[1]]).max(axis=1)
    share = np.minimum(1.0, MAX_TURN_RAD / np.maximum(turn, 1e-300))
    least = MAX_END_SLOPE_SHARE * np.sum(here.residual * step, axis=1)
    ends, falls = (
        np.stack([0 * share, share]),
        np.stack([least / MAX_END_SLOPE_SHARE, _energy_fall_rate(here, step, share)]),
    )
    going = np.flatnonzero((falls[1] < -least) & (least > 0))
    for _ in range(MAX_STEP_REDUCTIONS):
        if going.size == 0:
            break
        (low, high), (down, up) = ends[:, going], falls[:, going]
        # on an end it would stand still
        share[going] = low + (high - low) * np.clip(down / (down - up), 0.02, 0.98)
        fall = _energy_fall_rate(here.for_candidates(going), step[going], share[going])
        side = (fall <= 0).astype(int)
        ends[side, going], falls[side, going] = share[going], fall
        falls[1 - side, going] /= 2
        going = going[np.abs(fall) > least[going]]
    return share


def _energy_fall_rate(
    here: _RelaxingStrings, step: np.ndarray, share: np.ndarray
) -> np.ndarray:
    """How steeply the energy falls along a step where so much of it is taken, (C,)."""
    there = here.with_step(np.arange(len(step)), share[:, None] * step)
    return np.sum(there.residual * step, axis=1)


@dataclass(frozen=True)
class _RelaxingStrings:
    """Strings that are on their way to rest. pose: (C, 3). angles, lengths: (C, n - 1)."""

    chain: Chain
    pose: np.ndarray
    angles: np.ndarray
    lengths: np.ndarray

    def for_candidates(self, which: np.ndarray) -> _RelaxingStrings:
        """Some of the strings, by number."""
        return _RelaxingStrings(
            self.chain.for_candidates(which),
            *(part[which] for part in (self.pose, self.angles, self.lengths)),
        )

    def with_step(self, which: np.ndarray, step: np.ndarray) -> _RelaxingStrings:
        """The strings with those in `which` turned and stretched. step: (K, 2 n - 2),
        angles first [rad], then lengths [m].
        """
        angles, lengths = self.angles.copy(), self.lengths.copy()
        angles[which] += step[:, : angles.shape[1]]
        lengths[which] += step[:, angles.shape[1] :]
        return _RelaxingStrings(self.chain, self.pose, angles, lengths)

    @cached_property
    def tangents_and_positions(self) -> tuple[np.ndarray, np.ndarray]:
        """Directions of the segments and places of the free points [m], (C, n - 1, 2)
        each.
        """
        return tangents_and_positions(self.pose, self.angles, self.lengths)

    @property
    def tangent(self) -> np.ndarray:
        """Directions of the segments, (C, n - 1, 2)."""
        return self.tangents_and_positions[0]

    @cached_property
    def normal(self) -> np.ndarray:
        """(C, n - 1, 2)."""
        return np.stack([-self.tangent[..., 1], self.tangent[..., 0]], axis=-1)

    @cached_property
    def force(self) -> np.ndarray:
        """F, (C, n - 1, 2)."""
        tangent, places = self.tangents_and_positions
        return sum_to_tip(static_point_forces(self.chain, places, tangent))

    @cached_property
    def moments(self) -> tuple[np.ndarray, np.ndarray]:
        """Moments at the hinges, and their slopes with the hinge's angle, (C, n) each."""
        return hinge_moments(self.chain, self.pose[:, 2], self.angles)

    @cached_property
    def tension(self) -> tuple[np.ndarray, np.ndarray]:
        """Tension of the segments [m2/s2] and its slope with the stretch, (C, n - 1)
        each.
        """
        of, stretch = (
            (self.chain.string, self.chain.material),
            self.lengths / self.chain.segment_length - 1,
        )
        return slot_sum_and_slope(
            *of, "tension", "stretch", stretch, {"rate": np.zeros((1, 1))}
        )

    @cached_property
    def residual(self) -> np.ndarray:
        """Residual of the balances of moments and of tensions, (C, 2 n - 2)."""
        moment, _ = self.moments
        turning = (
            moment[:, 1:]
            - moment[:, :-1]
            + self.lengths * np.sum(self.force * self.normal, axis=-1)
        )
        pulling = np.sum(self.force * self.tangent, axis=-1) - self.tension[0]
        return np.concatenate([turning, pulling], axis=1)

    @property
    def newton_step(self) -> np.ndarray:
        """The step towards rest, (C, 2 n - 2): turns [rad], then changes of length [m].

        What destabilises counts only where it leaves the rest stable, so that a step
        never ends on a ridge.
        """
        yielding = self._position_stiffness()
        along = self.lengths * np.sum(self.force * self.tangent, axis=-1)
        across = np.sum(self.force * self.normal, axis=-1)
        matrix = self._local_matrix(along, across) - yielding
        stable = np.array([_is_positive_definite(one) for one in matrix])
        if not stable.all():
            held = (
                self._local_matrix(
                    np.maximum(along, MIN_TURN_STIFFNESS), np.zeros_like(across)
                )
                - yielding
            )
            matrix = np.where(stable[:, None, None], matrix, held)
        return np.linalg.solve(matrix, self.residual[..., None])[..., 0]

    def _local_matrix(self, along: np.ndarray, across: np.ndarray) -> np.ndarray:
        """The matrix of the balances if no force depended on the place, (C, 2 n - 2, 2
        n - 2).

        along, across: what of the forces counts, (C, n - 1).
        """
        count = self.angles.shape[1]
        _, stiffness = self.moments
        matrix = np.zeros((len(self.angles), 2 * count, 2 * count))
        turns, stretches = np.arange(count), np.arange(count, 2 * count)
        matrix[:, turns, turns] = stiffness[:, :-1] + stiffness[:, 1:] + along
        # A hinge turns with the segments on both of its sides, so that each knows its
        # neighbours.
        matrix[:, turns[1:], turns[:-1]] = matrix[
            :, turns[:-1], turns[1:]
        ] = -stiffness[:, 1:-1]
        matrix[:, stretches, stretches] = self.tension[1] / self.chain.segment_length
        matrix[:, turns, stretches] = matrix[:, stretches, turns] = -across
        return matrix

    def _position_stiffness(self) -> np.ndarray:
        """How the balances change because points change place, (C, 2 n - 2, 2 n - 2).

        Turning or stretching segment m moves all points beyond it by l_m n_m or t_m:
        with K the change of a point's force with its place, l_j n_j . (sum of K beyond
        both) l_m n_m, and so on.
        """
        tangent, places = self.tangents_and_positions
        ways = FORCE_DIFFERENCE_STEP_M * np.array(
            [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]]
        )
        moved = np.concatenate([places + way for way in ways])
        four = self.chain.for_candidates(np.tile(np.arange(len(tangent)), 4))
        pushed = static_point_forces(four, moved, np.tile(tangent, (4, 1, 1)))
        ahead, behind = pushed.reshape(2, 2, *places.shape)
        # K, (C, n - 1, 2, 2)
        change = np.moveaxis((ahead - behind) / (2 * FORCE_DIFFERENCE_STEP_M), 0, -1)
        order = np.arange(self.angles.shape[1])
        both = sum_to_tip(change)[:, np.maximum.outer(order, order)]
        turns = (self.lengths[..., None] * self.normal, self.tangent)
        return np.block(
            [
                [np.einsum("cja,cjmab,cmb->cjm", a, both, b) for b in turns]
                for a in turns
            ]
        )


def _is_positive_definite(matrix: np.ndarray) -> bool:
    """Whether a symmetric matrix is positive definite."""
    try:
        np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        return False
    return True
