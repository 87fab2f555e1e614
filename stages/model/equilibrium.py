"""The string at rest: the static equilibrium it hangs in before the first motion.

Unknown are the angles of the segments. The part of the string beyond a segment pulls with
a known force, so each segment gives one equation, the balance of moments about its start,

    M_{j+1} - M_j + l_j (F_y cos phi_j - F_x sin phi_j) = 0,

and its length follows from its tension. Newton steps from the shape of a heavy rod, with
the destabilising part of gravity left out of the matrix until close to the solution: a
string that leaves an upright hand then falls to a stable side rather than stand on its end.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stages.model.effect import placed
from stages.model.stability import load, slot_sum, vector_sum

if TYPE_CHECKING:
    from stages.model.string import String

ITERATIONS = 200
LARGEST_TURN = 0.3  # [rad] of a segment in one iteration
ENOUGH = 1e-12  # [rad] change of an angle that ends the iteration
GRAVITY = 9.81


def hanging(string: String, material: np.ndarray, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angles [rad] (continuous from the grasp) and lengths [m] of the segments at rest, (C, n - 1) each.

    material: (C, P). pose: (1 or C, 3) of the grasp. First as if nothing depended on place; where the string then
    touches something, or is pulled, it is sought anew.
    """
    pose = np.broadcast_to(pose, (len(material), 3))
    free, own = string.only(tuple(e for e in string.effects if not placed(e)), material)
    angles, lengths = _settled(free, own, pose)
    if free.effects != string.effects:
        with_all, without = (_force(*each, pose, angles, lengths) for each in ((string, material), (free, own)))
        held = np.any(with_all != without, axis=(1, 2))
        if held.any():
            angles[held], lengths[held] = _settled(string, material[held], pose[held])
    return angles, lengths


def _settled(string: String, material: np.ndarray, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angles and lengths, as `hanging`. pose: (C, 3)."""
    angles = _guess(string, material, pose[:, 2])
    lengths = np.full_like(angles, string.segment)
    moving = np.arange(len(material))
    limit, last = np.full((len(material), 1), LARGEST_TURN), np.zeros_like(angles)
    for _ in range(ITERATIONS):
        some, at = material[moving], pose[moving]
        force = _force(string, some, at, angles[moving], lengths[moving])
        lengths[moving] = _lengths(string, some, force, angles[moving], lengths[moving])
        place = _yielding(string, some, at, angles[moving], lengths[moving])
        turn = _newton(string, some, at[:, 2], force, place, angles[moving], lengths[moving])
        if place is not None:
            limit[moving] = _cautious(limit[moving], turn, last[moving])
            last[moving] = turn
        angles[moving] += np.clip(turn, -limit[moving], limit[moving])
        # Each candidate ends on its own, so that its shape does not depend on its company.
        moving = moving[np.abs(turn).max(axis=1) > ENOUGH]
        if moving.size == 0:
            break
    return angles, lengths


def stretched(string: String, material: np.ndarray, pose: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Lengths [m] of segments that are held at these angles [rad] and carry what hangs on them, (C, n - 1).

    material: (C, P). pose: (1 or C, 3) of the grasp.
    """
    plain = np.full(angles.shape, string.segment)
    force = _force(string, material, np.broadcast_to(pose, (len(material), 3)), angles, plain)
    lengths = plain
    for _ in range(4):
        lengths = _lengths(string, material, force, angles, lengths)
    return lengths


def _cautious(limit: np.ndarray, turn: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Smaller turns where a string goes back and forth between touching and not, larger ones again where it goes on."""
    back = np.sum(turn * last, axis=1, keepdims=True) < 0
    return np.where(back, 0.4 * limit, np.minimum(1.3 * limit, LARGEST_TURN))


def _guess(string: String, material: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """From the grasp's direction to straight down over the length on which weight bends the rod."""
    slope = _slope(string, material, "moment", "curvature", np.zeros((1, 1)))
    scale = (np.maximum(slope, 1e-12) / GRAVITY) ** (1 / 3)
    middle = string.arc_lengths()[None, 1:] - string.segment / 2
    fall = (-np.pi / 2 - theta + np.pi) % (2 * np.pi) - np.pi
    return theta[:, None] + fall[:, None] * (1 - np.exp(-middle / scale))


def _force(
    string: String,
    material: np.ndarray,
    pose: np.ndarray,
    angles: np.ndarray,
    lengths: np.ndarray,
) -> np.ndarray:
    """Force over nominal mass per length on the part beyond the start of each segment, (C, n - 1, 2) [m^2/s^2]."""
    tangent, places = _shape(pose, angles, lengths)
    return _beyond(_weight(string, material, places, tangent))


def _shape(pose: np.ndarray, angles: np.ndarray, lengths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Directions of the segments and places of the free points [m], (C, n - 1, 2) each."""
    tangent = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return tangent, pose[:, None, :2] + np.cumsum(lengths[..., None] * tangent, axis=1)


def _weight(
    string: String,
    material: np.ndarray,
    places: np.ndarray,
    tangent: np.ndarray,
) -> np.ndarray:
    """Force over nominal mass per length on each free point at rest, (C, n - 1, 2) [m^2/s^2]."""
    masses, cells = string.masses(material)
    x, y = places[..., 0], places[..., 1]
    s = string.arc_lengths()[None, 1:]
    pull = load(string, material, {"x": x, "y": y, "tx": tangent[..., 0], "ty": tangent[..., 1], "s": s})
    fall = vector_sum(string, material, "acceleration", {"x": x, "y": y, "t": np.zeros((1, 1))})
    return pull * cells[:, 1:, None] + fall * masses[:, 1:, None]


def _beyond(each: np.ndarray) -> np.ndarray:
    """Sums over a point and all beyond it. each: (C, n - 1, ...)."""
    return np.cumsum(each[:, ::-1], axis=1)[:, ::-1]


def _yielding(
    string: String,
    material: np.ndarray,
    pose: np.ndarray,
    angles: np.ndarray,
    lengths: np.ndarray,
) -> np.ndarray | None:
    """How the moments of the forces change with the angles because points change place, (C, n - 1, n - 1).

    Turning segment m moves all points beyond it: with K the change of a point's force with its
    place and n a segment's normal, l_j l_m n_j . (sum of K beyond both) n_m. None where no force
    depends on the place.
    """
    if not any(placed(effect) for effect in string.effects):
        return None
    tangent, places = _shape(pose, angles, lengths)
    change = []
    for step in 1e-7 * np.eye(2):
        up, down = (_weight(string, material, places + side * step, tangent) for side in (1, -1))
        change.append((up - down) / 2e-7)
    both = np.maximum.outer(np.arange(angles.shape[1]), np.arange(angles.shape[1]))
    stiff = _beyond(np.stack(change, axis=-1))[:, both]
    lever = lengths[..., None] * np.stack([-tangent[..., 1], tangent[..., 0]], axis=-1)
    return np.einsum("cja,cjmab,cmb->cjm", lever, stiff, lever)


def _lengths(
    string: String, material: np.ndarray, force: np.ndarray, angles: np.ndarray, lengths: np.ndarray
) -> np.ndarray:
    """Lengths at which tension balances the pull along each segment: two steps of Newton's method from `lengths`."""
    along = force[..., 0] * np.cos(angles) + force[..., 1] * np.sin(angles)
    stretch = lengths / string.segment - 1
    for _ in range(2):
        excess = slot_sum(string, material, "tension", {"stretch": stretch, "rate": 0 * stretch}) - along
        stretch = stretch - excess / _slope(string, material, "tension", "stretch", stretch)
        stretch = np.maximum(stretch, -0.9)
    return string.segment * (1 + stretch)


def _newton(
    string: String,
    material: np.ndarray,
    theta: np.ndarray,
    force: np.ndarray,
    place: np.ndarray | None,
    angles: np.ndarray,
    lengths: np.ndarray,
) -> np.ndarray:
    """One step towards the balance of moments, (C, n - 1) [rad]. place: `_yielding`."""
    moment, stiffness = _moments(string, material, theta, angles)
    across = lengths * (force[..., 1] * np.cos(angles) - force[..., 0] * np.sin(angles))
    along = lengths * (force[..., 0] * np.cos(angles) + force[..., 1] * np.sin(angles))
    balance = moment[:, 1:] - moment[:, :-1] + across
    close = np.abs(balance).max(axis=1, keepdims=True) < 1e-3 * np.abs(lengths * force[..., 1]).max(
        axis=1, keepdims=True
    )
    diagonal = stiffness[:, :-1] + stiffness[:, 1:] + np.where(close, along, np.maximum(along, 0.0))
    diagonal = np.maximum(diagonal, 1e-9)
    if place is None:
        return _tridiagonal(-stiffness[:, 1:-1], diagonal, balance)
    return np.linalg.solve(_full(-stiffness[:, 1:-1], diagonal) - place, balance[..., None])[..., 0]


def _full(off: np.ndarray, diagonal: np.ndarray) -> np.ndarray:
    """Symmetric tridiagonal matrices, (C, N, N). off: (C, N - 1), diagonal: (C, N)."""
    size = diagonal.shape[1]
    matrix = np.zeros((len(diagonal), size, size))
    before, after = np.arange(size - 1), np.arange(1, size)
    matrix[:, np.arange(size), np.arange(size)] = diagonal
    matrix[:, before, after] = matrix[:, after, before] = off
    return matrix


def _moments(
    string: String, material: np.ndarray, theta: np.ndarray, angles: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Moments at the hinges and their slope with the hinge angle, (C, n) each; the free end has none."""
    zero = np.zeros((1, 1))
    hinge = angles[:, :1] - theta[:, None] - grasp_set(string, material)
    first = slot_sum(string, material, "grasp_moment", {"angle": hinge, "rate": zero})
    first_slope = _slope(string, material, "grasp_moment", "angle", hinge)
    s = string.arc_lengths()[None, 1:-1]
    bend = np.diff(angles, axis=1) / string.segment - slot_sum(string, material, "rest_curvature", {"s": s})
    others = slot_sum(string, material, "moment", {"curvature": bend, "rate": zero, "s": s})
    slope = _slope(string, material, "moment", "curvature", bend) / string.segment
    end = np.zeros((len(material), 1))
    return np.concatenate([first, others, end], axis=1), np.concatenate([first_slope, slope, end], axis=1)


def grasp_set(string: String, material: np.ndarray) -> np.ndarray:
    """Angle at rest of the hinge at the grasp, from its share of the first segment's curvature, (C, 1) [rad]."""
    at_grasp = slot_sum(string, material, "rest_curvature", {"s": np.zeros((1, 1))})
    return string.grasp_cell * string.segment * at_grasp


def _slope(string: String, material: np.ndarray, slot: str, name: str, at: np.ndarray) -> np.ndarray:
    """Rise of a slot's laws with one argument, the rate being zero."""
    step = 1e-5 if name != "curvature" else 1e-3
    values = [slot_sum(string, material, slot, {name: at + d, "rate": 0 * at}) for d in (step, -step)]
    return (values[0] - values[1]) / (2 * step)


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
