"""What acts on a string at rest, for whatever seeks its equilibrium: forces, moments and how they change.

A string is here the angles phi [rad] (continuous from the grasp) and lengths l [m] of its segments, (C, n - 1) each,
and hangs from a pose (C, 3) of the grasp. Forces are over the nominal mass per length [m^2/s^2].
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from stringcast.stages.model.stability import load, slot_sum, vector_sum
from stringcast.stages.model.string import String

GRAVITY = 9.81
ITERATIONS = 200
LARGEST_TURN = 0.3  # [rad] of a segment in one iteration
FLOOR = 1e-9  # [m3/s2] of what resists a turn, so that a string without stiffness can be turned
ENOUGH = 1e-12  # [rad] change of an angle that ends the iteration


def guessed(string: String, material: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """From the grasp's direction to straight down over the length on which weight bends the rod."""
    zero = np.zeros((1, 1))
    _, stiffness = sloped(string, material, "moment", "curvature", zero, {"rate": zero})
    scale = (np.maximum(stiffness, 1e-12) / GRAVITY) ** (1 / 3)
    fall = (-np.pi / 2 - theta + np.pi) % (2 * np.pi) - np.pi
    middles = string.middles() * string.longer(material)[:, None]
    return theta[:, None] + fall[:, None] * (1 - np.exp(-middles / scale))


def plain(string: String, material: np.ndarray) -> np.ndarray:
    """Rest lengths of the segments, (C, n - 1) [m]."""
    return np.repeat(string.segments(material)[:, None], string.points - 1, axis=1)


def forces(
    string: String, material: np.ndarray, pose: np.ndarray, angles: np.ndarray, lengths: np.ndarray
) -> np.ndarray:
    """Force over nominal mass per length on the part beyond the start of each segment, (C, n - 1, 2) [m^2/s^2]."""
    tangent, places = shape(pose, angles, lengths)
    return beyond(weight(string, material, places, tangent))


def shape(pose: np.ndarray, angles: np.ndarray, lengths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Directions of the segments and places of the free points [m], (C, n - 1, 2) each."""
    tangent = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return tangent, pose[:, None, :2] + np.cumsum(lengths[..., None] * tangent, axis=1)


def weight(string: String, material: np.ndarray, places: np.ndarray, tangent: np.ndarray) -> np.ndarray:
    """Force over nominal mass per length on each free point at rest, (C, n - 1, 2) [m^2/s^2]."""
    masses, cells = string.masses(material)
    x, y = places[..., 0], places[..., 1]
    s = string.places(material)[:, 1:]
    pull = load(string, material, {"x": x, "y": y, "tx": tangent[..., 0], "ty": tangent[..., 1], "s": s})
    fall = vector_sum(string, material, "acceleration", {"x": x, "y": y, "t": np.zeros((1, 1))})
    return pull * cells[:, 1:, None] + fall * masses[:, 1:, None]


def beyond(each: np.ndarray) -> np.ndarray:
    """Sums over a point and all beyond it. each: (C, n - 1, ...)."""
    return np.cumsum(each[:, ::-1], axis=1)[:, ::-1]


def moments(
    string: String, material: np.ndarray, theta: np.ndarray, angles: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Moments at the hinges and their slope with the hinge angle, (C, n) each; the free end has none."""
    zero = np.zeros((1, 1))
    hinge = grasp_angle(string, material, theta, angles)
    first, first_slope = sloped(string, material, "grasp_moment", "angle", hinge, {"rate": zero})
    s = string.places(material)[:, 1:-1]
    bend = curvatures(string, material, angles)
    others, others_slope = sloped(string, material, "moment", "curvature", bend, {"rate": zero, "s": s})
    end = np.zeros((len(material), 1))
    slopes = [first_slope, others_slope / string.segments(material)[:, None], end]
    return np.concatenate([first, others, end], axis=1), np.concatenate(slopes, axis=1)


def curvatures(string: String, material: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Of the hinges, beyond that at rest, (C, n - 2) [1/m]. angles: (C, n - 1) of the segments [rad]."""
    s = string.places(material)[:, 1:-1]
    return np.diff(angles, axis=1) / string.segments(material)[:, None] - _at_rest(string, material, s)


def grasp_angle(string: String, material: np.ndarray, theta: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Of the hinge there, beyond that at rest, (C, 1) [rad]. theta: (1 or C,) of the hand. angles: (C, n - 1)."""
    return angles[:, :1] - theta[:, None] - grasp_set(string, material)


def grasp_set(string: String, material: np.ndarray) -> np.ndarray:
    """Angle at rest of the hinge at the grasp, from its share of the first segment's curvature, (C, 1) [rad]."""
    return string.grasp_cell * string.segments(material)[:, None] * _at_rest(string, material, np.zeros((1, 1)))


def softness(string: String, material: np.ndarray) -> np.ndarray:
    """Length of string [m] that turns as far as the hinge at the grasp under a moment, (C,)."""
    zero = np.zeros((1, 1))
    _, bending = sloped(string, material, "moment", "curvature", zero, {"rate": zero})
    _, grasp = sloped(string, material, "grasp_moment", "angle", zero, {"rate": zero})
    return (bending / np.maximum(grasp, FLOOR))[:, 0]


def _at_rest(string: String, material: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Curvature at rest at these arc lengths, (C, M) [1/m]. s: (1 or C, M) [m]."""
    length = string.length * string.longer(material)[:, None]
    return slot_sum(string, material, "rest_curvature", {"s": s, "length": length})


def sloped(
    string: String, material: np.ndarray, slot: str, name: str, at: np.ndarray, others: Mapping[str, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Sum of a slot's laws, and its rise with one argument, (C, M) each.

    at: (1 or C, M) of that argument. others: the slot's other arguments, (1, 1 or M) each. Asked in one call: with so
    few numbers it is the calls that take the time.
    """
    step = 1e-3 if name == "curvature" else 1e-5
    three = np.hstack([at, at + step, at - step])
    wide = {key: np.tile(value, 3) if value.shape[1] > 1 else value for key, value in others.items()}
    here, more, less = np.split(slot_sum(string, material, slot, {name: three, **wide}), 3, axis=1)
    return here, (more - less) / (2 * step)
