"""Bounds of the step for stability, for all active forces.

The slopes of each law with stretch, curvature or their rates are sampled over the range
that a string can reach, so a new effect needs no declaration. The largest eigenvalues
of the chain's axial, bending and grasp operators convert slopes to squared frequencies
and damping rates. Their sum bounds the whole.
"""

from __future__ import annotations

from functools import cache, lru_cache

import numpy as np

from stringcast.stages.model.engine.law_slots import MEMORY_SLOTS
from stringcast.stages.model.string import String

STEP_SAFETY_FACTOR = 0.9  # of the largest stable step
MAX_DRAG_SPEED_M_S = 30.0  # largest speed in the air
MAX_STIFFENING_STRETCH = 0.2  # its tension stiffens the string sideways
STEP_SIZE_RATIO = 1.2  # of successive sizes of steps
INSTANT_S = 1e-9  # too short for relaxation
MAX_STEPS_PER_TICK = 5000  # a candidate that needs more is rejected
DIFFERENCE_FRACTION = 1e-4  # of the range of an argument, to difference a law
SPEED_DIFFERENCE = 1e-3  # of the speed, to difference drag

DEFAULT_ARGUMENTS = dict.fromkeys(
    ("x", "y", "vx", "vy", "ty", "s", "t", "dt"), np.zeros((1, 1))
) | {"tx": np.ones((1, 1))}
SAMPLED_ARGUMENTS: dict[str, tuple[tuple[str, np.ndarray], ...]] = {
    "tension": (
        ("stretch", np.linspace(-0.1, 0.3, 9)),
        ("rate", np.linspace(-50.0, 50.0, 9)),
    ),
    "moment": (
        ("curvature", np.linspace(-100.0, 100.0, 9)),
        ("rate", np.linspace(-3000.0, 3000.0, 9)),
    ),
    "grasp_moment": (
        ("angle", np.linspace(-3.0, 3.0, 9)),
        ("rate", np.linspace(-100.0, 100.0, 9)),
    ),
}

Slopes = tuple[np.ndarray, np.ndarray]


def steps_per_tick(
    string: String, material: np.ndarray, tick: float, slopes: Slopes | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Find the number of steps of each candidate in a tick.

    Only a few sizes of steps exist (each about 1.2 times the last), so that candidates
    can run side by side. A candidate's size does not depend on others.

    Parameters
    ----------
    string : String
        The string and its effects.
    material : ndarray of shape (C, P)
        Material properties, as `String.material`.
    tick : float
        Length of a tick [s].
    slopes : tuple of ndarray, optional
        Known result of `sampled_slopes`.

    Returns
    -------
    steps : ndarray of int, shape (C,)
        Steps in a tick.
    possible : ndarray of bool, shape (C,)
        Whether the number is practical.
    """
    if slopes is None:
        slopes = sampled_slopes(string, material)
    frequency2, damping = frequency_and_damping_bounds(string, material, slopes)
    drag = _drag_rate(string, material)
    stable = string.integrator.largest_stable_step(frequency2, damping, drag)
    step = np.minimum(STEP_SAFETY_FACTOR * stable, string.largest_step)
    needed = tick / np.maximum(step, 1e-300)
    possible = np.isfinite(needed) & (needed <= MAX_STEPS_PER_TICK)
    needed = np.maximum(np.where(possible, needed, 1.0), 1.0)

    # Round up to the next power of the ratio, then to the next integer. The 1e-9 allows
    # for rounding errors of an exact power.
    exponent = np.ceil(np.log(needed) / np.log(STEP_SIZE_RATIO) - 1e-9)
    steps = np.ceil(STEP_SIZE_RATIO**exponent - 1e-9).astype(int)
    return steps, possible


def _drag_rate(string: String, material: np.ndarray) -> np.ndarray:
    """Find the damping rate of loads at the fastest speed covered, (C,) [1/s].

    Loads that declare a bound are excluded. They depend on place, so one sample does
    not bound them.
    """
    undeclared = [e for e in string.effects if not hasattr(e, "bound")]
    plain, undeclared_material = string.with_only_effects(tuple(undeclared), material)
    # Slope of the load with the speed along x and along y, by a difference.
    slow = MAX_DRAG_SPEED_M_S
    fast = slow * (1.0 + SPEED_DIFFERENCE)
    vx = np.array([[slow, fast, 0.0, 0.0]])
    vy = np.array([[0.0, 0.0, slow, fast]])
    loads = load_sum(plain, undeclared_material, {"vx": vx, "vy": vy})  # (C, 4, 2)
    rises = loads[:, 1::2] - loads[:, ::2]  # (C, 2, 2)
    steepest = np.abs(rises).max(axis=(1, 2)) / (SPEED_DIFFERENCE * slow)
    masses, cells = plain.point_masses(undeclared_material)
    return steepest * (cells / masses).max(axis=1)


def frequency_and_damping_bounds(
    string: String, material: np.ndarray, slopes: Slopes
) -> Slopes:
    """Bound squared frequency [1/s^2] and damping rate [1/s] of explicit forces.

    Both are (3 or more, C), with the rows axial, bending, grasp, and one for each load
    that declares a bound. slopes: result of `sampled_slopes`.
    """
    masses, cells = string.point_masses(material)
    ratio = string.free_length_ratio(material)
    # Strings that differ only in length share eigenvalues.
    scaled_masses = masses / ratio[:, None]
    eigenvalues = [_operator_eigenvalues(m[1:].tobytes()) for m in scaled_masses]
    axial, bending, grasp = np.array(eigenvalues).T / ratio
    length = string.free_segment_lengths(material)
    operators = np.stack([axial / length, bending / length**3, grasp / length**2])

    integrator = string.integrator
    stiffness, damping = integrator.step_limiting_slope(*slopes)
    memory_stiffness = memory_stiffness_bounds(string, material)
    for row, slot in enumerate(SAMPLED_ARGUMENTS):
        if slot in MEMORY_SLOTS and MEMORY_SLOTS[slot][1] in integrator.averaged_slots:
            memory_stiffness[row] = 0.0
    stiffness = stiffness + memory_stiffness
    stiffening = np.array([[1 + MAX_STIFFENING_STRETCH], [1.0], [1.0]])
    frequency2 = [*(stiffening * stiffness * operators)]
    damping_rates = [*(damping * operators)]

    lightest = (cells / masses).max(axis=1)
    for effect in string.effects:
        if hasattr(effect, "bound"):
            effect_values = string.values_of(effect, material)
            declared_frequency2, declared_damping = effect.bound(**effect_values)
            frequency2.append(lightest * declared_frequency2)
            damping_rates.append(lightest * declared_damping)
    return np.stack(frequency2), np.stack(damping_rates)


def sampled_slopes(string: String, material: np.ndarray) -> Slopes:
    """Find the largest and smallest slopes of tension, moment and grasp moment.

    Both are (2, 3, C): first slopes with stretch, curvature and angle (stiffness), then
    those with their rates (damping). The largest counts by magnitude; the smallest is
    at least 0. Laws that the integrator averages completely are excluded.
    """
    steepest, gentlest = [], []
    averaged = string.integrator.averaged_slots
    for slot in SAMPLED_ARGUMENTS:
        arguments, step, rate_step = _difference_arguments(slot)
        total = slot_sum(
            string, material, slot, arguments, "hinge_stiffness" not in averaged
        )
        groups = np.moveaxis(total.reshape(len(total), 4, -1), 1, 0)  # (4, C, M)
        stiffness = (groups[0] - groups[1]) / (2 * step)
        damping = (groups[2] - groups[3]) / (2 * rate_step)
        slopes = np.stack([stiffness, damping])
        steepest.append(np.abs(slopes).max(axis=2))
        gentlest.append(np.maximum(slopes.min(axis=2), 0.0))
    return np.swapaxes(steepest, 0, 1), np.swapaxes(gentlest, 0, 1)


def averageable_slopes(
    string: String, material: np.ndarray, gentlest: np.ndarray
) -> Slopes:
    """Find the stiffness and damping that an implicit step may average, (3, C) each.

    They are the smallest slopes of the laws, plus the slopes of moments with memory
    after a reversal. gentlest: smallest slopes, as in `sampled_slopes`, (2, 3, C).
    """
    stiffness, damping = gentlest
    return stiffness + memory_stiffness_bounds(string, material), damping


def memory_stiffness_bounds(string: String, material: np.ndarray) -> np.ndarray:
    """Bound the slopes of moments with memory with respect to their bend, (3, C).

    Rows are those of `sampled_slopes`. Such a moment is steepest at a reversal, which
    is tried from states over the whole range.
    """
    steepest = np.zeros((len(SAMPLED_ARGUMENTS), len(material)))
    for row, slot in enumerate(SAMPLED_ARGUMENTS):
        if slot not in MEMORY_SLOTS or not string.memory_count(slot):
            continue
        _, bends = SAMPLED_ARGUMENTS[slot][0]
        farthest = string.updated_memory(slot, material, bends[None, -1:])
        shares = np.linspace(-1.0, 1.0, 9)
        states = [memory * shares for memory in farthest]
        before = list(string.memory_moments(slot, material, states))
        for change in (1e-6, -1e-6):  # [1/m] or [rad]
            bend = np.full((1, 1), change)
            bent = string.updated_memory(slot, material, bend, states, INSTANT_S)
            total = np.zeros(len(material))
            after = string.memory_moments(slot, material, bent)
            for moment, moment_before in zip(after, before, strict=True):
                rise = (moment - moment_before) / change
                total = total + rise.max(axis=1)
            steepest[row] = np.maximum(steepest[row], total)
    return steepest


@cache
def _difference_arguments(slot: str) -> tuple[dict[str, np.ndarray], float, float]:
    """Return arguments of a slot for central differences at its M samples.

    Returns
    -------
    arguments : dict of ndarray, shape (1, 4 M)
        Both arguments in four groups: the first one step above its samples, then below;
        the second one step above, then below.
    step, rate_step : float
        The steps of the first and second argument.
    """
    (first, values), (second, rates) = SAMPLED_ARGUMENTS[slot]
    grids = np.meshgrid(values, rates, indexing="ij")
    value, rate = np.reshape(grids, (2, 1, -1))
    step = DIFFERENCE_FRACTION * float(np.ptp(values))
    rate_step = DIFFERENCE_FRACTION * float(np.ptp(rates))
    arguments = {
        first: np.hstack([value + step, value - step, value, value]),
        second: np.hstack([rate, rate, rate + rate_step, rate - rate_step]),
    }
    return arguments, step, rate_step


def slot_sum(
    string: String,
    material: np.ndarray,
    slot: str,
    arguments: dict[str, np.ndarray],
    with_hinge_stiffness: bool = True,
) -> np.ndarray:
    """Sum a slot's scalar laws for all candidates, (C, M), without memory.

    The moment includes laws per curvature if `with_hinge_stiffness`. arguments: the
    slot's arguments, (1 or C, M) each.
    """
    columns = max(value.shape[1] for value in arguments.values())
    start = np.zeros((len(material), columns))
    total = string.law_sum(slot, material, arguments, start)
    if slot == "moment" and with_hinge_stiffness:
        for stiffness in string.law_values("hinge_stiffness", material, arguments):
            total = total + stiffness * arguments["curvature"]
    return total


def load_sum(
    string: String, material: np.ndarray, arguments: dict[str, np.ndarray]
) -> np.ndarray:
    """Sum the loads, (C, M, 2) [m/s^2].

    Missing arguments are 0, and the tangent points to the right.
    """
    known = DEFAULT_ARGUMENTS | arguments
    air = vector_slot_sum(string, material, "flow", known)
    known["ux"] = known["vx"] - air[..., 0]
    known["uy"] = known["vy"] - air[..., 1]
    return vector_slot_sum(string, material, "load", known)


def vector_slot_sum(
    string: String, material: np.ndarray, slot: str, arguments: dict[str, np.ndarray]
) -> np.ndarray:
    """Sum a slot's vector laws for all candidates, (C, M, 2).

    arguments: the slot's arguments, (1 or C, M) each.
    """
    columns = max(value.shape[1] for value in arguments.values())
    total = np.zeros((len(material), columns, 2))
    for x, y in string.law_values(slot, material, arguments):
        total[..., 0] += x
        total[..., 1] += y
    return total


@lru_cache(4096)
def _operator_eigenvalues(masses: bytes) -> tuple[float, float, float]:
    """Find the largest eigenvalues of a chain's operators for unit segments.

    The operators are first differences (axial), second differences (bending) and the
    turn of the first segment (grasp), weighted by the masses.

    masses: masses of the free points, (n - 1,) float64 [m], as bytes for the cache.
    """
    inverse_root = 1.0 / np.sqrt(np.frombuffer(masses))
    shift = np.eye(len(inverse_root), k=-1)
    difference = np.eye(len(inverse_root)) - shift
    second_difference = (difference - shift @ difference)[1:]
    axial = np.linalg.norm(difference * inverse_root, ord=2) ** 2
    bending = np.linalg.norm(second_difference * inverse_root, ord=2) ** 2
    grasp = np.linalg.norm(difference[:1] * inverse_root, ord=2) ** 2
    return float(axial), float(bending), float(grasp)
