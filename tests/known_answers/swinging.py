"""Frequency and energy of a swinging string."""

import numpy as np


def frequency(t: np.ndarray, x: np.ndarray) -> float:
    """Return the mean frequency [rad/s] from rising zero crossings, interpolated."""
    up = np.flatnonzero((x[:-1] < 0) & (x[1:] >= 0))
    crossing = t[up] - x[up] * (t[up + 1] - t[up]) / (x[up + 1] - x[up])
    return 2 * np.pi * (len(crossing) - 1) / (crossing[-1] - crossing[0])


def segment_angles(points: np.ndarray) -> np.ndarray:
    """Return the angles of the segments of strings (F, n, 2), (F, n - 1) [rad]."""
    x, y = np.moveaxis(np.diff(points, axis=1), -1, 0)
    return np.unwrap(np.arctan2(y, x), axis=1)


def mechanical_energy(
    points: np.ndarray, t: np.ndarray, segment_length: float, values: dict
) -> np.ndarray:
    """Return the energy over the mass of one point, (F,) [m2/s2].

    It is kinetic, potential and elastic, without the hinge at the grasp.
    """
    velocity = np.gradient(points, t, axis=0)[:, 1:]
    stretch = np.linalg.norm(np.diff(points, axis=1), axis=-1) - segment_length
    bend = np.diff(segment_angles(points), axis=1)
    energy = 0.5 * (velocity**2).sum(axis=(1, 2)) + 9.81 * points[:, 1:, 1].sum(axis=1)
    energy += 0.5 * values["axial_stiffness"] * (stretch**2).sum(axis=1)
    return energy + 0.5 * values["bending_stiffness"] * (bend**2).sum(axis=1)
