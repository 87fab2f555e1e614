"""Static equilibrium of a hanging string, its state before the first motion.

The unknowns are the angles phi_j of the segments. The part of the string beyond a
segment pulls with a known force F, so each segment has one equation, the balance of
moments about its start,

    M_{j+1} - M_j + l_j (F_y cos phi_j - F_x sin phi_j) = 0,

and its length l_j follows from its tension. Newton's method starts from the shape of a
heavy rod. Far from the solution its matrix excludes the destabilising part of gravity,
so that a string in an upright hand falls to a stable side.

The outer loop evaluates the laws and their slopes, in Python. The inner loop solves the
balance for these linearised laws, in compiled code. Linear laws need two or three outer
iterations. `contact_equilibrium` treats forces that depend on the place.
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

NEAR_BALANCE_SHARE = 1e-3  # residual near the solution, over the moment of the weight
MIN_STRETCH = -0.9
STRETCH_STEPS = 4  # of Newton; a linear law needs one, and one more for rounding

Shape = tuple[np.ndarray, np.ndarray]


def hanging_shape(
    string: String,
    material: np.ndarray,
    pose: np.ndarray,
    turn: float | np.ndarray = 0.0,
) -> Shape:
    """Find the static equilibrium of hanging strings.

    First it is found without forces that depend on the place. If such a force acts
    there, `contact_shape` finds it again.

    Parameters
    ----------
    string : String
        The string and its effects.
    material : ndarray of shape (C, P)
        Material properties, as `String.material`.
    pose : ndarray of shape (1 or C, 3)
        Pose of the grasp [m], [m], [rad].
    turn : float or ndarray of shape (C,)
        Approximate turn of the string from the hand to its end [rad]. It selects the
        side on which the string hangs from a hand that points up.

    Returns
    -------
    angles, lengths : ndarray of shape (C, n - 1)
        Angles of the segments, unwrapped from the grasp [rad], and lengths [m].
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
    """Find the shape as `hanging_shape`, if no force depends on the place.

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
        # Each candidate stops independently, so its shape does not depend on others.
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
    """Find the turns to balance for linearised laws, and lengths, (C, n - 1) each.

    The laws are linearised at these angles and lengths, because their evaluation takes
    most of the time.
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
    """Return the fraction of a step to take, (C, 1), from that of the last step.

    It is halved if the step reverses most of the last one. Otherwise steps could
    alternate between both sides of a kink in a law forever.
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

    tension_tangent: stretch, tension and its slope, (C, N) each. hinge_tangent: moments
    and their slope with the hinge's angle, (C, N + 1) each. turn (zeros at first) and
    lengths, (C, N) each, are changed in place.
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

                # Tension balances the pull.
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

    A destabilising pull is included only near the solution. stiffness: k, (N + 1,).
    residual and upper, (N,) each, are overwritten.
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
    """Find the lengths of segments at given angles in static equilibrium.

    They are (C, n - 1) [m]. material: (C, P). pose: pose of the grasp, (1 or C, 3).
    angles: (C, n - 1) [rad].
    """
    chain = Chain.from_material(string, material)
    poses = np.broadcast_to(pose, (len(material), 3))
    force = forces_beyond_segments(chain, poses, angles, chain.rest_lengths)
    along = force[..., 0] * np.cos(angles) + force[..., 1] * np.sin(angles)
    stretch = np.zeros_like(along)
    for _ in range(STRETCH_STEPS):  # towards tension = pull
        tension, rise = slot_sum_and_slope(string, material, "tension", stretch)
        stretch = np.maximum(stretch - (tension - along) / rise, MIN_STRETCH)
    return chain.segment_length * (1 + stretch)
