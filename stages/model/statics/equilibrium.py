"""The string at rest: the static equilibrium it hangs in before the first motion.

Unknown are the angles of the segments. The part of the string beyond a segment pulls
with a known force, so each segment gives one equation, the balance of moments about its
start,

    M_{j+1} - M_j + l_j (F_y cos phi_j - F_x sin phi_j) = 0,

and its length follows from its tension. Newton steps from the shape of a heavy rod,
with the destabilising part of gravity left out of the matrix until close to the
solution: a string that leaves an upright hand then falls to a stable side rather than
stand on its end. The laws are asked for their tangents, by which the shape is sought in
compiled code, and again where that leads, until nothing turns: twice or three times
where they are straight. Where forces depend on the place, for the string leans on
something, see `contact_equilibrium`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from stringcast.stages.model.effect import is_position_dependent
from stringcast.stages.model.statics.chain import (
    ANGLE_TOLERANCE_RAD,
    MAX_ITERATIONS,
    MAX_TURN_RAD,
    MIN_TURN_STIFFNESS,
    Chain,
    forces_beyond_segments,
    guess_angles,
    hinge_moments,
    rest_lengths,
    slot_sum_and_slope,
)
from stringcast.stages.model.statics.contact_equilibrium import contact_shape
from stringcast.stages.model.string import String

# of the moment of the weight: what is left of a balance that is nearly found
NEAR_BALANCE_SHARE = 1e-3


def hanging_shape(
    string: String,
    material: np.ndarray,
    pose: np.ndarray,
    turn: float | np.ndarray = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Angles [rad] (continuous from the grasp) and lengths [m] of the segments at rest,
    (C, n - 1) each.

    material: (C, P). pose: (1 or C, 3) of the grasp. turn: about how far a string turns
    from the hand to its end [rad], (C,) or of all: from a hand that points up it hangs
    down on one side or on the other, the nearer of which this tells. First as if
    nothing depended on place; where the string then touches something, or is pulled, it
    is sought anew.
    """
    pose, turn = (
        np.broadcast_to(pose, (len(material), 3)),
        np.broadcast_to(turn, len(material)),
    )
    free, own = string.with_only_effects(
        tuple(e for e in string.effects if not is_position_dependent(e)), material
    )
    angles, lengths = _free_hanging_shape(free, own, pose, turn)
    if free.effects != string.effects:
        with_all, without = (
            forces_beyond_segments(Chain.from_material(*each), pose, angles, lengths)
            for each in ((string, material), (free, own))
        )
        held = np.any(with_all != without, axis=(1, 2))
        if held.any():
            angles[held], lengths[held] = contact_shape(
                string, material[held], pose[held], turn[held]
            )
    return angles, lengths


def _free_hanging_shape(
    string: String, material: np.ndarray, pose: np.ndarray, turn: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Angles and lengths, as `hanging`, where no force depends on the place. pose: (C,
    3). turn: (C,).
    """
    chain = Chain.from_material(string, material)
    angles, lengths = (
        guess_angles(string, material, pose[:, 2], turn),
        rest_lengths(string, material),
    )
    force = forces_beyond_segments(chain, pose, angles, lengths)
    # what pulls, with the string
    turning = string.uses_argument(
        ("load", "flow", "acceleration"), ("x", "y", "tx", "ty")
    )
    last, share = np.zeros_like(angles), np.ones((len(angles), 1))
    moving = np.arange(len(material))
    for _ in range(MAX_ITERATIONS):
        some = chain if moving.size == len(material) else chain.for_candidates(moving)
        if turning:
            force[moving] = forces_beyond_segments(
                some, pose[moving], angles[moving], lengths[moving]
            )

        # to where all is balanced, by the tangents of the laws here: to ask the laws
        # takes longer than all else
        stretch = lengths[moving] / some.segment_length - 1
        pull = slot_sum_and_slope(
            some.string,
            some.material,
            "tension",
            "stretch",
            stretch,
            {"rate": np.zeros((1, 1))},
        )
        step, long = np.zeros_like(stretch), np.empty_like(stretch)
        hinges = hinge_moments(some, pose[moving, 2], angles[moving])
        _solve_balance(
            force[moving],
            angles[moving],
            (stretch, *pull),
            hinges,
            some.segment_length[:, 0],
            step,
            long,
        )
        lengths[moving] = long

        # half a step where it goes back by most of the last, as from one side of a kink
        # in a law to the other: whole steps would do so for ever
        most = np.abs(step).max(axis=1, keepdims=True)
        against = np.sum(step * last[moving], axis=1, keepdims=True) < 0
        back = against & (most > 0.5 * np.abs(last[moving]).max(axis=1, keepdims=True))
        share[moving] = np.where(
            back, 0.5 * share[moving], np.minimum(2 * share[moving], 1)
        )
        angles[moving] += share[moving] * step
        last[moving] = step
        # Each candidate ends on its own, so that its shape does not depend on its
        # company.
        moving = moving[most[:, 0] > ANGLE_TOLERANCE_RAD]
        if moving.size == 0:
            break
    return angles, lengths


@njit(nogil=True, cache=True, error_model="numpy")
def _solve_balance(
    force: np.ndarray,
    angles: np.ndarray,
    pull: tuple[np.ndarray, np.ndarray, np.ndarray],
    hinges: tuple[np.ndarray, np.ndarray],
    segment: np.ndarray,
    turn: np.ndarray,
    lengths: np.ndarray,
) -> None:
    """Newton's method for each candidate. pull: stretch, and tension and its rise
    there, (C, N) each. hinges: moments and their rise with the hinge's angle, (C, N +
    1) each. turn: zeros, and lengths, (C, N) each, filled in place.
    """
    count, size = angles.shape
    balance, diagonal, upper = np.empty(size), np.empty(size), np.empty(size)
    for c in range(count):
        moment, stiffness = hinges[0][c], hinges[1][c]
        for _ in range(MAX_ITERATIONS):
            most, heaviest, before = 0.0, 0.0, 0.0
            for j in range(size):
                cos, sin = (
                    np.cos(angles[c, j] + turn[c, j]),
                    np.sin(angles[c, j] + turn[c, j]),
                )
                along = force[c, j, 0] * cos + force[c, j, 1] * sin
                stretch = pull[0][c, j] + (along - pull[1][c, j]) / pull[2][c, j]
                lengths[c, j] = segment[c] * (1 + max(stretch, -0.9))
                after = (turn[c, j + 1] if j < size - 1 else turn[c, j]) - turn[c, j]
                here = turn[c, j] - before
                before = turn[c, j]
                balance[j] = (
                    moment[j + 1]
                    + stiffness[j + 1] * after
                    - moment[j]
                    - stiffness[j] * here
                )
                balance[j] += lengths[c, j] * (
                    force[c, j, 1] * cos - force[c, j, 0] * sin
                )
                diagonal[j] = lengths[c, j] * along
                most, heaviest = (
                    max(most, abs(balance[j])),
                    max(heaviest, abs(lengths[c, j] * force[c, j, 1])),
                )
            close = most < NEAR_BALANCE_SHARE * heaviest
            if (
                _turn_segments(stiffness, diagonal, balance, upper, close, turn[c])
                <= ANGLE_TOLERANCE_RAD
            ):
                break


@njit(nogil=True, cache=True, error_model="numpy")
def _turn_segments(
    stiffness: np.ndarray,
    along: np.ndarray,
    balance: np.ndarray,
    upper: np.ndarray,
    close: bool,
    turn: np.ndarray,
) -> float:
    """One step of one candidate, added to its turn (N,), and its largest part [rad]: a
    symmetric tridiagonal system. stiffness: (N + 1,). along: (N,) of the pull, which
    resists a turn. upper: room, (N,).
    """
    last, most, pivot = len(turn) - 1, 0.0, 1.0
    for j in range(last + 1):
        diagonal = max(
            stiffness[j]
            + stiffness[j + 1]
            + (along[j] if close else max(along[j], 0.0)),
            MIN_TURN_STIFFNESS,
        )
        if j > 0:
            upper[j - 1] = -stiffness[j] / pivot
            balance[j] += stiffness[j] * balance[j - 1]
            diagonal += stiffness[j] * upper[j - 1]
        pivot = diagonal
        balance[j] /= pivot
    for j in range(last, -1, -1):
        if j < last:
            balance[j] -= upper[j] * balance[j + 1]
        most = max(most, abs(balance[j]))
        turn[j] += min(max(balance[j], -MAX_TURN_RAD), MAX_TURN_RAD)
    return most


def stretched_lengths(
    string: String, material: np.ndarray, pose: np.ndarray, angles: np.ndarray
) -> np.ndarray:
    """Lengths [m] of segments that are held at these angles [rad] and carry what hangs
    on them, (C, n - 1).

    material: (C, P). pose: (1 or C, 3) of the grasp.
    """
    chain, lengths, still = (
        Chain.from_material(string, material),
        rest_lengths(string, material),
        {"rate": np.zeros((1, 1))},
    )
    force = forces_beyond_segments(
        chain, np.broadcast_to(pose, (len(material), 3)), angles, lengths
    )
    along = force[..., 0] * np.cos(angles) + force[..., 1] * np.sin(angles)
    for _ in range(4):
        stretch = lengths / chain.segment_length - 1
        # steps of Newton's method to where tension balances the pull along each segment
        for _ in range(2):
            tension, rise = slot_sum_and_slope(
                string, material, "tension", "stretch", stretch, still
            )
            stretch = np.maximum(stretch - (tension - along) / rise, -0.9)
        lengths = chain.segment_length * (1 + stretch)
    return lengths
