"""The string at rest: the static equilibrium it hangs in before the first motion.

The unknowns are the angles phi_j of the segments. The part of the string beyond a
segment pulls with a known force F, so each segment gives one equation, the balance of
moments about its start,

    M_{j+1} - M_j + l_j (F_y cos phi_j - F_x sin phi_j) = 0,

and its length l_j follows from its tension. Newton steps start from the shape of a
heavy rod. The destabilising part of gravity is left out of the matrix until close to
the solution: a string that leaves an upright hand then falls to a stable side rather
than stand on its end.

There are two loops. The outer one evaluates the laws and their tangents, in Python. The
inner one solves the balance with these tangents, in compiled code. Laws that are linear
need two or three rounds. Where forces depend on the place, because the string leans on
something, see `contact_equilibrium`.
"""

from __future__ import annotations

import numpy as np

from stringcast.stages.model.effect import is_position_dependent
from stringcast.stages.model.engine.threads import compile_kernel
from stringcast.stages.model.statics.chain import (
    ANGLE_TOLERANCE_RAD,
    MAX_ITERATIONS,
    MAX_TURN_RAD,
    MIN_TURN_STIFFNESS,
    Chain,
    forces_beyond_segments,
    guess_angles,
    hinge_moments,
    slot_sum_and_slope,
)
from stringcast.stages.model.statics.contact_equilibrium import contact_shape
from stringcast.stages.model.string import String

NEAR_BALANCE_SHARE = 1e-3  # of the moment of the weight: residual of a near balance
MIN_STRETCH = -0.9

Shape = tuple[np.ndarray, np.ndarray]


def hanging_shape(
    string: String,
    material: np.ndarray,
    pose: np.ndarray,
    turn: float | np.ndarray = 0.0,
) -> Shape:
    """Find how strings hang at rest.

    The shape is found first as if no force depended on place. Where the string then
    touches something, or is pulled, it is found again by `contact_shape`.

    Parameters
    ----------
    string : String
        The string and its effects.
    material : ndarray of shape (C, P)
        Material properties, as `String.material`.
    pose : ndarray of shape (1 or C, 3)
        Pose of the grasp [m], [m], [rad].
    turn : float or ndarray of shape (C,)
        About how far the string turns from the hand to its end [rad]. From a hand that
        points up it hangs down on one side or on the other; the nearer one is taken.

    Returns
    -------
    angles, lengths : ndarray of shape (C, n - 1)
        Of the segments [rad], continuous from the grasp, and [m].
    """
    pose = np.broadcast_to(pose, (len(material), 3))
    turn = np.broadcast_to(turn, len(material))
    free_effects = [e for e in string.effects if not is_position_dependent(e)]
    free, free_material = string.with_only_effects(tuple(free_effects), material)
    angles, lengths = _free_hanging_shape(free, free_material, pose, turn)
    if free.effects == string.effects:
        return angles, lengths

    chain = Chain.from_material(string, material)
    free_chain = Chain.from_material(free, free_material)
    force = forces_beyond_segments(chain, pose, angles, lengths)
    free_force = forces_beyond_segments(free_chain, pose, angles, lengths)
    touches = np.any(force != free_force, axis=(1, 2))
    if touches.any():
        angles[touches], lengths[touches] = contact_shape(
            string, material[touches], pose[touches], turn[touches]
        )
    return angles, lengths


def _free_hanging_shape(
    string: String, material: np.ndarray, pose: np.ndarray, turn: np.ndarray
) -> Shape:
    """Find angles and lengths as `hanging_shape` where no force depends on the place.

    pose: (C, 3). turn: (C,).
    """
    chain = Chain.from_material(string, material)
    angles = guess_angles(chain, pose[:, 2], turn)
    lengths = chain.rest_lengths
    force = forces_beyond_segments(chain, pose, angles, lengths)
    turns_with_string = string.uses_argument(
        ("load", "flow", "acceleration"), ("x", "y", "tx", "ty")
    )
    last_step = np.zeros_like(angles)
    share = np.ones((len(angles), 1))
    moving = np.arange(len(material))
    for _ in range(MAX_ITERATIONS):
        moving_chain = chain
        if moving.size < len(material):
            moving_chain = chain.for_candidates(moving)
        if turns_with_string:
            force[moving] = forces_beyond_segments(
                moving_chain, pose[moving], angles[moving], lengths[moving]
            )

        step, lengths[moving] = _balancing_step(
            moving_chain, pose[moving], angles[moving], lengths[moving], force[moving]
        )
        share[moving] = _damped_share(share[moving], step, last_step[moving])
        angles[moving] += share[moving] * step
        last_step[moving] = step
        # Each candidate ends on its own, so that its shape does not depend on its
        # company.
        moving = moving[np.abs(step).max(axis=1) > ANGLE_TOLERANCE_RAD]
        if moving.size == 0:
            break
    return angles, lengths


def _balancing_step(
    chain: Chain,
    pose: np.ndarray,
    angles: np.ndarray,
    lengths: np.ndarray,
    force: np.ndarray,
) -> Shape:
    """Find by how much angles turn for balance, and the lengths then, (C, n - 1) each.

    The laws are taken along their tangents at these angles and lengths: evaluating them
    takes longer than all else.
    """
    stretch = lengths / chain.segment_length - 1
    tension = slot_sum_and_slope(chain.string, chain.material, "tension", stretch)
    step = np.zeros_like(stretch)
    balanced_lengths = np.empty_like(stretch)
    _solve_balance(
        force,
        angles,
        (stretch, *tension),
        hinge_moments(chain, pose[:, 2], angles),
        chain.segment_length[:, 0],
        step,
        balanced_lengths,
    )
    return step, balanced_lengths


def _damped_share(
    share: np.ndarray, step: np.ndarray, last_step: np.ndarray
) -> np.ndarray:
    """Return the share of a step to take, (C, 1), from that of the last step.

    It is halved where the step reverses most of the last, as from one side of a kink in
    a law to the other: whole steps would do so for ever.
    """
    largest = np.abs(step).max(axis=1, keepdims=True)
    last_largest = np.abs(last_step).max(axis=1, keepdims=True)
    is_against = np.sum(step * last_step, axis=1, keepdims=True) < 0
    reverses = is_against & (largest > 0.5 * last_largest)
    return np.where(reverses, 0.5 * share, np.minimum(2 * share, 1))


@compile_kernel
def _solve_balance(
    force: np.ndarray,
    angles: np.ndarray,
    tension_tangent: tuple[np.ndarray, np.ndarray, np.ndarray],
    hinge_tangent: tuple[np.ndarray, np.ndarray],
    segment_length: np.ndarray,
    turn: np.ndarray,
    lengths: np.ndarray,
) -> None:
    """Solve the balance of moments of each candidate by Newton's method.

    tension_tangent: stretch, and tension and its slope there, (C, N) each.
    hinge_tangent: moments and their slope with the hinge's angle, (C, N + 1) each.
    turn: zeros, and lengths, (C, N) each, filled in place.
    """
    stretch, tension, tension_slope = tension_tangent
    count, size = angles.shape
    residual, pull, upper = np.empty(size), np.empty(size), np.empty(size)
    for c in range(count):
        moment, stiffness = hinge_tangent[0][c], hinge_tangent[1][c]
        for _ in range(MAX_ITERATIONS):
            largest_residual, largest_weight, turn_before = 0.0, 0.0, 0.0
            for j in range(size):
                angle = angles[c, j] + turn[c, j]
                cos, sin = np.cos(angle), np.sin(angle)
                along = force[c, j, 0] * cos + force[c, j, 1] * sin
                across = force[c, j, 1] * cos - force[c, j, 0] * sin

                # Tension carries the pull.
                change = (along - tension[c, j]) / tension_slope[c, j]
                balanced_stretch = max(stretch[c, j] + change, MIN_STRETCH)
                length = segment_length[c] * (1 + balanced_stretch)
                lengths[c, j] = length

                # M_{j+1} - M_j + l_j n_j . F_j
                bend = turn[c, j] - turn_before
                bend_beyond = turn[c, j + 1] - turn[c, j] if j < size - 1 else 0.0
                turn_before = turn[c, j]
                moment_beyond = moment[j + 1] + stiffness[j + 1] * bend_beyond
                residual[j] = moment_beyond - moment[j] - stiffness[j] * bend
                residual[j] += length * across
                pull[j] = length * along

                weight = length * force[c, j, 1]
                largest_residual = max(largest_residual, abs(residual[j]))
                largest_weight = max(largest_weight, abs(weight))

            is_near = largest_residual < NEAR_BALANCE_SHARE * largest_weight
            largest_turn = _turn_segments(
                stiffness, pull, residual, upper, is_near, turn[c]
            )
            if largest_turn <= ANGLE_TOLERANCE_RAD:
                break


@compile_kernel
def _turn_segments(
    stiffness: np.ndarray,
    pull: np.ndarray,
    residual: np.ndarray,
    upper: np.ndarray,
    is_near: bool,
    turn: np.ndarray,
) -> float:
    """Add one Newton step d to a candidate's turn (N,) [rad]; return its largest part.

    With the pull p_j = l_j t_j . F_j it solves, by the Thomas algorithm,

        -k_j d_{j-1} + (k_j + k_{j+1} + p_j) d_j - k_{j+1} d_{j+1} = residual_j.

    A pull that destabilises counts near the solution only. stiffness: k, (N + 1,).
    residual: is overwritten. upper: room, (N,).
    """
    last, largest, pivot = len(turn) - 1, 0.0, 1.0
    for j in range(last + 1):
        resistance = pull[j] if is_near else max(pull[j], 0.0)
        diagonal = max(stiffness[j] + stiffness[j + 1] + resistance, MIN_TURN_STIFFNESS)
        if j > 0:
            upper[j - 1] = -stiffness[j] / pivot
            residual[j] += stiffness[j] * residual[j - 1]
            diagonal += stiffness[j] * upper[j - 1]
        pivot = diagonal
        residual[j] /= pivot
    for j in range(last, -1, -1):
        if j < last:
            residual[j] -= upper[j] * residual[j + 1]
        largest = max(largest, abs(residual[j]))
        turn[j] += min(max(residual[j], -MAX_TURN_RAD), MAX_TURN_RAD)
    return largest


def stretched_lengths(
    string: String, material: np.ndarray, pose: np.ndarray, angles: np.ndarray
) -> np.ndarray:
    """Find the lengths of segments held at given angles that carry what hangs on them.

    (C, n - 1) [m]. material: (C, P). pose: (1 or C, 3) of the grasp. angles: (C, n - 1)
    [rad].
    """
    chain = Chain.from_material(string, material)
    lengths = chain.rest_lengths
    poses = np.broadcast_to(pose, (len(material), 3))
    force = forces_beyond_segments(chain, poses, angles, lengths)
    along = force[..., 0] * np.cos(angles) + force[..., 1] * np.sin(angles)
    for _ in range(4):
        stretch = lengths / chain.segment_length - 1
        for _ in range(2):  # Newton steps to where tension balances the pull
            tension, rise = slot_sum_and_slope(string, material, "tension", stretch)
            stretch = np.maximum(stretch - (tension - along) / rise, MIN_STRETCH)
        lengths = chain.segment_length * (1 + stretch)
    return lengths
