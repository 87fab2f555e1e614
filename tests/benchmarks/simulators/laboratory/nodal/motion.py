"""A rod at rest in the hand, and how it moves when the hand does."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tests.benchmarks.simulators.laboratory.hand import Path
from tests.benchmarks.simulators.laboratory.nodal.dynamics import (
    MOMENTS,
    State,
    forces,
    integrate,
    tangent,
)
from tests.benchmarks.simulators.laboratory.nodal.elements import Mesh
from tests.benchmarks.simulators.laboratory.rod import Rod

STILL = 1e-9  # [m] of a Newton step at rest
LARGEST = 0.05  # of a step towards rest, of places [m] and of slopes
RELAXED = 400  # steps in which a string comes to rest
LONG_AGO = -1e6  # [s], when nothing that begins in a trial acts


@dataclass(frozen=True)
class Motion:
    """States on a uniform grid. t: (K,) [s]. q, v: (K, D, 2) nodal coordinates and
    their rates, NaN where lost.
    """

    mesh: Mesh
    t: np.ndarray
    q: np.ndarray
    v: np.ndarray

    def points(self, times: np.ndarray, arc: np.ndarray) -> np.ndarray:
        """Positions (F, S, 2) at times (F,) [s] and arc lengths (S,) [m], cubic between
        steps.
        """
        step = self.t[1] - self.t[0]
        before = np.clip(((times - self.t[0]) / step).astype(int), 0, len(self.t) - 2)
        x = ((times - self.t[before]) / step)[:, None, None]
        weights = self.mesh.at(arc)
        here, there, now, then = (
            weights @ part[k] for part in (self.q, self.v) for k in (before, before + 1)
        )
        rise = there - here
        bend = (now * step - rise) * (1 - x) - (then * step - rise) * x
        return np.asarray(here + x * rise + x * (1 - x) * bend)


def moved(rod: Rod, path: Path, elements: int, step: float) -> Motion:
    """The rod from rest, as the hand takes it along, in steps of at most `step` [s]."""
    mesh = Mesh.of(rod, elements)
    t = np.linspace(path.start, path.end, math.ceil((path.end - path.start) / step) + 1)
    dt = t[1] - t[0]
    hand = path.at((t[:-1, None] + dt * MOMENTS).ravel()).reshape(-1, len(MOMENTS), 8)
    begun = rest(mesh, path.at(t[:1])[0])
    q, v = integrate(t[0], dt, begun, hand, rod.record, mesh.compiled)
    return Motion(mesh, t, q, v)


def rest(mesh: Mesh, hand: np.ndarray) -> np.ndarray:
    """Nodal coordinates (D, 2) at rest in a hand (8,), by pseudo-transient
    continuation: implicit steps in time without inertia, ever longer, until they are
    Newton's. It starts from a rod that turns down on the shorter way.
    """
    q = _turned_down(mesh, hand)
    mass = np.kron(mesh.mass[1:, 1:], np.eye(2))
    slowness = 1e3  # [1/s2], of the first steps
    for _ in range(RELAXED):
        left, slope = _balance(mesh, q, hand)
        step = np.linalg.solve(slowness * mass - slope, left)
        size = np.abs(step).max()
        q[1:] += step.reshape(-1, 2) * min(1.0, LARGEST / size)
        if size < STILL:
            break
        slowness = slowness / 3 if size < LARGEST else slowness
    return q


def _turned_down(mesh: Mesh, hand: np.ndarray) -> np.ndarray:
    """A rod that turns from the grasp's direction into that of gravity within its first
    half, (D, 2).
    """
    rod = mesh.rod
    arc = np.linspace(0, rod.length, mesh.elements + 1)
    turn = math.remainder(
        math.atan2(rod.gravity_y, rod.gravity_x) - hand[6], 2 * math.pi
    )
    angle = hand[6] + turn * np.minimum(2 * arc / rod.length, 1.0)
    q = np.zeros((2 * len(arc), 2))
    q[1::2] = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    q[2::2] = np.cumsum(0.5 * (q[1:-2:2] + q[3::2]) * arc[1], axis=0)
    q[0::2] += hand[:2]
    return q


def _balance(
    mesh: Mesh, q: np.ndarray, hand: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Forces at rest on the free coordinates (2 D - 2,), and their slopes by these."""
    still, none = np.zeros_like(q), np.zeros((*mesh.places.shape, 2))
    parts, now = (hand, mesh.rod.record, mesh.compiled), State(q, still, none, 0.0, 0.0)
    force = mesh.weight + forces(LONG_AGO, now, *parts, np.empty_like(none))
    band = tangent(LONG_AGO, now, 1.0, *parts)
    rows, width = band.shape
    slope = np.zeros((rows, rows + width - 1))
    for i in range(rows):
        slope[i, i : i + width] = band[i]
    return force[1:].ravel(), slope[2:, width // 2 + 2 : width // 2 + rows]
