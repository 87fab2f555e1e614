"""A rod at rest in the hand, and its motion when the hand moves."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tests.benchmarks.simulators.hand import GraspPath
from tests.benchmarks.simulators.nodal.assembly import State, all_forces, force_slopes
from tests.benchmarks.simulators.nodal.elements import Mesh
from tests.benchmarks.simulators.nodal.sdirk import STAGE_TIMES, integrate
from tests.benchmarks.simulators.rod import Rod

REST_TOLERANCE_M = 1e-9  # largest Newton step at rest
LARGEST_REST_STEP = 0.05  # in positions [m] and in slopes
MAX_REST_STEPS = 400
INITIAL_SLOWNESS = 1e3  # [1/s2]
LONG_AGO_S = -1e6  # a time before anything that begins in a trial


@dataclass(frozen=True)
class NodalMotion:
    """States on a uniform grid; see `StringMotion`.

    Parameters
    ----------
    mesh : the rod
    t : (K,) [s]
    q, v : (K, D, 2) nodal coordinates and their rates, NaN where it diverged
    """

    mesh: Mesh
    t: np.ndarray
    q: np.ndarray
    v: np.ndarray

    def points(self, times: np.ndarray, arc: np.ndarray) -> np.ndarray:
        """Return positions (F, S, 2) [m], cubic between steps."""
        step = self.t[1] - self.t[0]
        before = np.clip(((times - self.t[0]) / step).astype(int), 0, len(self.t) - 2)
        x = ((times - self.t[before]) / step)[:, None, None]
        weights = self.mesh.position_weights(arc)
        place, next_place = weights @ self.q[before], weights @ self.q[before + 1]
        rate, next_rate = weights @ self.v[before], weights @ self.v[before + 1]
        rise = next_place - place
        bend = (rate * step - rise) * (1 - x) - (next_rate * step - rise) * x
        return np.asarray(place + x * rise + x * (1 - x) * bend)


def simulate_rod(
    rod: Rod, path: GraspPath, elements: int, largest_step: float
) -> NodalMotion:
    """Simulate a rod that starts from rest and follows the grasp.

    Parameters
    ----------
    rod : the string
    path : of the grasp
    elements : their number
    largest_step : in time [s]
    """
    mesh = Mesh.of_rod(rod, elements)
    steps = math.ceil((path.end - path.start) / largest_step)
    t = np.linspace(path.start, path.end, steps + 1)
    dt = t[1] - t[0]
    stage_times = (t[:-1, None] + dt * STAGE_TIMES).ravel()
    hand = path.states(stage_times).reshape(-1, len(STAGE_TIMES), 8)
    start = rest_coordinates(mesh, path.states(t[:1])[0])
    q, v = integrate(t[0], dt, start, hand, rod.record, mesh.as_elements)
    return NodalMotion(mesh, t, q, v)


def rest_coordinates(mesh: Mesh, hand: np.ndarray) -> np.ndarray:
    """Return the nodal coordinates (D, 2) at rest in a hand (8,).

    Pseudo-transient continuation: implicit steps in time without inertia, ever longer,
    until they are Newton's. It starts from a rod that turns down on the shorter way.
    """
    q = _turned_down(mesh, hand)
    mass = np.kron(mesh.mass[1:, 1:], np.eye(2))
    slowness = INITIAL_SLOWNESS
    for _ in range(MAX_REST_STEPS):
        force, slopes = _balance(mesh, q, hand)
        step = np.linalg.solve(slowness * mass - slopes, force)
        size = np.abs(step).max()
        q[1:] += step.reshape(-1, 2) * min(1.0, LARGEST_REST_STEP / size)
        if size < REST_TOLERANCE_M:
            break
        if size < LARGEST_REST_STEP:
            slowness = slowness / 3
    return q


def _turned_down(mesh: Mesh, hand: np.ndarray) -> np.ndarray:
    """Return a rod that turns into the direction of gravity in its first half."""
    rod = mesh.rod
    arc = np.linspace(0, rod.length, mesh.elements + 1)
    down = math.atan2(rod.gravity_y, rod.gravity_x)
    turn = math.remainder(down - hand[6], 2 * math.pi)
    angle = hand[6] + turn * np.minimum(2 * arc / rod.length, 1.0)
    q = np.zeros((2 * len(arc), 2))
    q[1::2] = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    q[2::2] = np.cumsum(0.5 * (q[1:-2:2] + q[3::2]) * arc[1], axis=0)
    q[0::2] += hand[:2]
    return q


def _balance(
    mesh: Mesh, q: np.ndarray, hand: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the forces at rest on the free coordinates (2 D - 2,) and their slopes."""
    memory = np.zeros((*mesh.places.shape, 2))
    state = State(q, np.zeros_like(q), memory, 0.0, 0.0)
    string = mesh.rod.record, mesh.as_elements
    new_memory = np.empty_like(memory)
    force = all_forces(LONG_AGO_S, state, hand, *string, new_memory)
    band = force_slopes(LONG_AGO_S, state, 1.0, hand, *string)
    rows, width = band.shape
    slopes = np.zeros((rows, rows + width - 1))
    for i in range(rows):
        slopes[i, i : i + width] = band[i]
    free = slopes[2:, width // 2 + 2 : width // 2 + rows]
    return (mesh.weight + force)[1:].ravel(), free
