"""How small a step must be: a bound that covers every force at work.

Each law's slopes (how steeply it rises with stretch, curvature or their rates) are
sampled over the range a string can meet, so that a new effect is covered without being
asked. The slopes are turned into squared frequencies and damping rates by the largest
eigenvalues of the chain's axial, bending and grasp operators, whose sum bounds that of
all together.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, lru_cache

import numpy as np

from stringcast.stages.model.engine.law_slots import MEMORY_SLOTS, PROPORTIONAL_SLOTS
from stringcast.stages.model.string import String

STEP_SAFETY_FACTOR = 0.9  # of the largest stable step
MAX_DRAG_SPEED_M_S = 30.0  # [m/s] speed up to which air resistance is covered
MAX_STIFFENING_STRETCH = 0.2  # stretch whose tension stiffens the string sideways
STEP_SIZE_RATIO = 1.2  # ratio of one size of step to the next
INSTANT_S = 1e-9  # [s] in which nothing relaxes
# in a tick; more is impractical, and the candidate is rejected
MAX_STEPS_PER_TICK = 5000

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


def steps_per_tick(
    string: String, material: np.ndarray, tick: float
) -> tuple[np.ndarray, np.ndarray]:
    """Steps in a tick for each candidate, and which candidates are practical at all.

    material: (C, P). Steps come in a few sizes (each about 1.2 times the last), so that
    candidates can run side by side; a candidate's own depends on nothing but itself.
    """
    frequency2, damping = frequency_and_damping_bounds(string, material)

    # damping rate of the loads at the fastest speed covered, but of those that declare
    # theirs: these depend on place, and what they are in one place says nothing
    plain, own = string.with_only_effects(
        tuple(e for e in string.effects if not hasattr(e, "bound")), material
    )
    bit = 1e-3
    fast, faster, no = MAX_DRAG_SPEED_M_S, MAX_DRAG_SPEED_M_S * (1.0 + bit), 0.0
    pulls = load_sum(
        plain,
        own,
        {
            "vx": np.array([[fast, faster, no, no]]),
            "vy": np.array([[no, no, fast, faster]]),
        },
    )
    worst = np.abs(pulls[:, 1::2] - pulls[:, ::2]).max(axis=(1, 2)) / (
        bit * MAX_DRAG_SPEED_M_S
    )
    masses, cells = plain.point_masses(own)
    drag = np.asarray(worst * (cells / masses).max(axis=1))

    stable = string.integrator.largest_stable_step(frequency2, damping, drag)
    step = np.minimum(STEP_SAFETY_FACTOR * stable, string.largest_step)
    needed = tick / np.maximum(step, 1e-300)
    possible = np.isfinite(needed) & (needed <= MAX_STEPS_PER_TICK)
    # a whole number may come out a little above itself, hence the 1e-9
    level = np.ceil(
        np.log(np.maximum(np.where(possible, needed, 1.0), 1.0))
        / np.log(STEP_SIZE_RATIO)
        - 1e-9
    )
    return np.ceil(STEP_SIZE_RATIO**level - 1e-9).astype(int), possible


def frequency_and_damping_bounds(
    string: String, material: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of squared frequency [1/s^2] and damping rate [1/s], (3 or more, C) each:
    axial, bending, grasp, and those that loads declare. Of what the string's integrator
    leaves explicit.
    """
    masses, cells = string.point_masses(material)
    longer = string.free_length_ratio(material)
    alike = masses / longer[:, None]  # in strings that differ in length alone
    axial, bending, grasp = (
        np.array([_operator_eigenvalues(mass[1:].tobytes()) for mass in alike]).T
        / longer
    )
    stiffness, damping = string.integrator.step_limiting_slope(
        *sampled_slopes(string, material)
    )
    explicit = [
        [
            slot in MEMORY_SLOTS
            and MEMORY_SLOTS[slot][1] not in string.integrator.averaged_slots
        ]
        for slot in SAMPLED_ARGUMENTS
    ]
    stiffness = stiffness + explicit * memory_stiffness_bounds(string, material)
    length = string.free_segment_lengths(material)
    reach = np.stack([axial / length, bending / length**3, grasp / length**2])
    taut = np.array([[1 + MAX_STIFFENING_STRETCH], [1.0], [1.0]])
    stiff, damped = taut * stiffness * reach, damping * reach
    lightest = (cells / masses).max(axis=1)
    for effect in string.effects:
        if hasattr(effect, "bound"):
            more = [
                lightest * part
                for part in effect.bound(**string.effect_parameters(effect, material))
            ]
            stiff, damped = (
                np.concatenate([rows, part[None]])
                for rows, part in zip((stiff, damped), more, strict=True)
            )
    return stiff, damped


def sampled_slopes(
    string: String, material: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Steepest and gentlest rise of the laws of tension, moment and grasp moment, (2,
    3, C) each.

    Without what the string's integrator averages as it is.

    [0]: with stretch, curvature, angle (stiffness); [1]: with their rates (damping).
    The steepest is the largest magnitude; the gentlest is what rises everywhere, at
    least 0.
    """
    steepest, gentlest = [], []
    for slot in SAMPLED_ARGUMENTS:
        around, da, db = _difference_arguments(slot)
        total = slot_sum(
            string, material, slot, around, string.integrator.averaged_slots
        )
        more, less, faster, slower = np.moveaxis(total.reshape(len(total), 4, -1), 1, 0)
        rises = (more - less) / (2 * da), (faster - slower) / (2 * db)
        steepest.append([np.abs(rise).max(axis=1) for rise in rises])
        gentlest.append([np.maximum(rise.min(axis=1), 0.0) for rise in rises])
    return np.swapaxes(steepest, 0, 1), np.swapaxes(gentlest, 0, 1)


def averageable_slopes(
    string: String, material: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness and damping that an implicit step may average, (3, C) each, as
    `slopes`: what rises everywhere, and what hinges and the grasp hold where they turn
    back.
    """
    _, (stiffness, damping) = sampled_slopes(string, material)
    return stiffness + memory_stiffness_bounds(string, material), damping


def memory_stiffness_bounds(string: String, material: np.ndarray) -> np.ndarray:
    """Steepest rise with curvature and angle of the moments that hinges and the grasp
    hold, (3, C), as `slopes`: where they turn back.
    """
    steepest = np.zeros((len(SAMPLED_ARGUMENTS), len(material)))
    for row, slot in enumerate(SAMPLED_ARGUMENTS):
        if slot not in MEMORY_SLOTS or not string.memory_count(slot):
            continue
        farthest = np.full((1, 1), SAMPLED_ARGUMENTS[slot][0][1][-1])
        states = [
            each * np.linspace(-1.0, 1.0, 9)
            for each in string.updated_memory(slot, material, farthest)
        ]
        before = list(string.memory_moments(slot, material, states))
        for bit in (1e-6, -1e-6):  # [1/m] or [rad]
            bent = string.updated_memory(
                slot, material, np.full((1, 1), bit), states, INSTANT_S
            )
            after = string.memory_moments(slot, material, bent)
            rises = [
                ((new - old) / bit).max(axis=1)
                for new, old in zip(after, before, strict=True)
            ]
            steepest[row] = np.maximum(
                steepest[row], sum(rises, np.zeros(len(material)))
            )
    return steepest


@cache
def _difference_arguments(slot: str) -> tuple[dict[str, np.ndarray], float, float]:
    """A slot's two arguments a little above and below each sample, one after the other,
    (1, 4 M), and how much.
    """
    (first, values), (second, speeds) = SAMPLED_ARGUMENTS[slot]
    a, b = (grid.ravel()[None] for grid in np.meshgrid(values, speeds, indexing="ij"))
    da, db = 1e-4 * float(np.ptp(values)), 1e-4 * float(np.ptp(speeds))
    return (
        {
            first: np.hstack([a + da, a - da, a, a]),
            second: np.hstack([b, b, b + db, b - db]),
        },
        da,
        db,
    )


def slot_sum(
    string: String,
    material: np.ndarray,
    slot: str,
    given: dict[str, np.ndarray],
    apart: Sequence[str] = (),
) -> np.ndarray:
    """Sum of a slot's scalar laws for all candidates, (C, M), with those that are per
    one of its arguments; not of what hinges hold.

    given: the slot's arguments, (1 or C, M) each. apart: slots of the latter that do
    not count.
    """
    total = np.zeros((len(material), max(value.shape[1] for value in given.values())))
    for more in string.law_values(slot, material, given):
        total = total + more
    for per, (other, name) in PROPORTIONAL_SLOTS.items():
        if other == slot and per not in apart:
            for each in string.law_values(per, material, given):
                total = total + each * given[name]
    return total


def load_sum(
    string: String, material: np.ndarray, given: dict[str, np.ndarray]
) -> np.ndarray:
    """Sum of the loads, (C, M, 2) [m/s^2]; arguments not given are 0, the tangent
    points right.
    """
    known = DEFAULT_ARGUMENTS | given
    air = vector_slot_sum(string, material, "flow", known)
    known |= {"ux": known["vx"] - air[..., 0], "uy": known["vy"] - air[..., 1]}
    return vector_slot_sum(string, material, "load", known)


def vector_slot_sum(
    string: String, material: np.ndarray, slot: str, known: dict[str, np.ndarray]
) -> np.ndarray:
    """Sum of a slot's vector laws for all candidates, (C, M, 2). known: the slot's
    arguments, (1 or C, M) each.
    """
    total = np.zeros(
        (len(material), max(value.shape[1] for value in known.values()), 2)
    )
    for parts in string.law_values(slot, material, known):
        for axis, part in enumerate(parts):
            total[..., axis] += part
    return total


@lru_cache(4096)
def _operator_eigenvalues(masses: bytes) -> tuple[float, float, float]:
    """Largest eigenvalues of a chain's operators for unit segments: of first
    differences (axial), of second differences (bending) and of the first segment's turn
    (grasp). masses: of its free points, (n - 1,) float64 [m].
    """
    root = 1.0 / np.sqrt(np.frombuffer(masses))
    first = np.eye(len(root)) - np.eye(len(root), k=-1)
    second = (first - np.eye(len(root), k=-1) @ first)[1:]
    axial, bending, grasp = (
        float(np.linalg.norm(rows * root, ord=2) ** 2)
        for rows in (first, second, first[:1])
    )
    return axial, bending, grasp
