"""The string at rest: the static equilibrium it hangs in before the first motion.

Unknown are the angles of the segments. The part of the string beyond a segment pulls with
a known force, so each segment gives one equation, the balance of moments about its start,

    M_{j+1} - M_j + l_j (F_y cos phi_j - F_x sin phi_j) = 0,

and its length follows from its tension. Newton steps from the shape of a heavy rod, with
the destabilising part of gravity left out of the matrix until close to the solution: a
string that leaves an upright hand then falls to a stable side rather than stand on its end.
Where forces depend on the place, for the string leans on something, see `leaning`.
"""

from __future__ import annotations

import numpy as np

from stringcast.stages.model.effect import placed
from stringcast.stages.model.leaning import leaning
from stringcast.stages.model.statics import (
    ENOUGH,
    FLOOR,
    ITERATIONS,
    LARGEST_TURN,
    Chain,
    forces,
    guessed,
    moments,
    plain,
    sloped,
)
from stringcast.stages.model.string import String

CLOSE = 1e-3  # of the moment of the weight: what is left of a balance that is nearly found


def hanging(string: String, material: np.ndarray, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angles [rad] (continuous from the grasp) and lengths [m] of the segments at rest, (C, n - 1) each.

    material: (C, P). pose: (1 or C, 3) of the grasp. First as if nothing depended on place; where the string then
    touches something, or is pulled, it is sought anew.
    """
    pose = np.broadcast_to(pose, (len(material), 3))
    free, own = string.only(tuple(e for e in string.effects if not placed(e)), material)
    angles, lengths = _settled(free, own, pose)
    if free.effects != string.effects:
        with_all, without = (
            forces(Chain.of(*each), pose, angles, lengths) for each in ((string, material), (free, own))
        )
        held = np.any(with_all != without, axis=(1, 2))
        if held.any():
            angles[held], lengths[held] = leaning(string, material[held], pose[held])
    return angles, lengths


def _settled(string: String, material: np.ndarray, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angles and lengths, as `hanging`, where no force depends on the place. pose: (C, 3)."""
    chain = Chain.of(string, material)
    angles, lengths = guessed(string, material, pose[:, 2]), plain(string, material)
    force = forces(chain, pose, angles, lengths)
    last, share = np.zeros_like(angles), np.ones((len(angles), 1))
    moving = np.arange(len(material))
    for _ in range(ITERATIONS):
        some = chain.only(moving)
        if not chain.rigid_weight:
            force[moving] = forces(some, pose[moving], angles[moving], lengths[moving])
        lengths[moving] = _lengths(some, force[moving], angles[moving], lengths[moving])
        turn = _newton(some, pose[moving, 2], force[moving], angles[moving], lengths[moving])
        share[moving] = np.where(_back_again(turn, last[moving]), 0.5 * share[moving], np.minimum(2 * share[moving], 1))
        angles[moving] += share[moving] * np.clip(turn, -LARGEST_TURN, LARGEST_TURN)
        last[moving] = turn
        # Each candidate ends on its own, so that its shape does not depend on its company.
        moving = moving[np.abs(turn).max(axis=1) > ENOUGH]
        if moving.size == 0:
            break
    return angles, lengths


def _back_again(turn: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Whether a step goes back by most of the last, (C, 1), as from one side of a kink in a law to the other and back:
    whole steps would do so for ever. turn, last: (C, n - 1)."""
    size = np.abs(last).max(axis=1, keepdims=True)
    against = np.sum(turn * last, axis=1, keepdims=True) < 0
    return against & (np.abs(turn).max(axis=1, keepdims=True) > 0.5 * size)


def stretched(string: String, material: np.ndarray, pose: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Lengths [m] of segments that are held at these angles [rad] and carry what hangs on them, (C, n - 1).

    material: (C, P). pose: (1 or C, 3) of the grasp.
    """
    chain, lengths = Chain.of(string, material), plain(string, material)
    force = forces(chain, np.broadcast_to(pose, (len(material), 3)), angles, lengths)
    for _ in range(4):
        lengths = _lengths(chain, force, angles, lengths)
    return lengths


def _lengths(chain: Chain, force: np.ndarray, angles: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Lengths at which tension balances the pull along each segment: two steps of Newton's method from `lengths`."""
    along = force[..., 0] * np.cos(angles) + force[..., 1] * np.sin(angles)
    stretch = lengths / chain.segment - 1
    for _ in range(2):
        tension, rise = sloped(chain.string, chain.material, "tension", "stretch", stretch, {"rate": np.zeros((1, 1))})
        stretch = np.maximum(stretch - (tension - along) / rise, -0.9)
    return chain.segment * (1 + stretch)


def _newton(chain: Chain, theta: np.ndarray, force: np.ndarray, angles: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """One step towards the balance of moments, (C, n - 1) [rad]."""
    moment, stiffness = moments(chain, theta, angles)
    across = lengths * (force[..., 1] * np.cos(angles) - force[..., 0] * np.sin(angles))
    along = lengths * (force[..., 0] * np.cos(angles) + force[..., 1] * np.sin(angles))
    balance = moment[:, 1:] - moment[:, :-1] + across
    size = np.abs(lengths * force[..., 1]).max(axis=1, keepdims=True)
    close = np.abs(balance).max(axis=1, keepdims=True) < CLOSE * size
    diagonal = stiffness[:, :-1] + stiffness[:, 1:] + np.where(close, along, np.maximum(along, 0.0))
    diagonal = np.maximum(diagonal, FLOOR)
    return _tridiagonal(-stiffness[:, 1:-1], diagonal, balance)


def _tridiagonal(off: np.ndarray, diagonal: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve symmetric tridiagonal systems side by side. off: (C, N - 1), diagonal, right: (C, N)."""
    upper, solution = np.zeros_like(diagonal), np.zeros_like(diagonal)
    upper[:, 0], solution[:, 0] = (off[:, 0] if off.shape[1] else 0) / diagonal[:, 0], right[:, 0] / diagonal[:, 0]
    for j in range(1, diagonal.shape[1]):
        pivot = diagonal[:, j] - off[:, j - 1] * upper[:, j - 1]
        if j < off.shape[1]:
            upper[:, j] = off[:, j] / pivot
        solution[:, j] = (right[:, j] - off[:, j - 1] * solution[:, j - 1]) / pivot
    for j in range(diagonal.shape[1] - 2, -1, -1):
        solution[:, j] -= upper[:, j] * solution[:, j + 1]
    return solution
