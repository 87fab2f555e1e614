"""`simulate` moves many candidates of a string at once along a hand's motion."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from stringcast.stages.model.engine import kernel_codegen
from stringcast.stages.model.engine.law_slots import MEMORY_SLOTS
from stringcast.stages.model.engine.sampling import (
    interpolate_along_string,
    interpolate_ticks,
    is_bounded,
    last_needed_tick,
)
from stringcast.stages.model.engine.stability import averageable_slopes, steps_per_tick
from stringcast.stages.model.hand import HandMotion, append_rest_ticks
from stringcast.stages.model.state import StringState
from stringcast.stages.model.statics.chain import (
    Chain,
    grasp_compliance_length,
    grasp_hinge_angle,
    grasp_rest_angle,
    hinge_curvatures,
)
from stringcast.stages.model.statics.equilibrium import hanging_shape, stretched_lengths
from stringcast.stages.model.string import String

# [1/m] or [rad] by which a hinge is bent to hold what it would on its way back: no
# law's memory goes further
FULL_REVERSAL_BEND = 1e3


@dataclass(frozen=True)
class StringMotion:
    """Simulated strings at `arc_lengths` from the stated grasp. points: (C, F, n, 2)
    [m], NaN where a run was rejected; finite: (C,) bool.
    """

    points: np.ndarray
    finite: np.ndarray

    @property
    def tip(self) -> np.ndarray:
        """(C, F, 2) [m]."""
        return self.points[:, :, -1]


def simulate(
    string: String,
    hand: HandMotion,
    values: np.ndarray,
    times: np.ndarray,
    initial: StringState | None = None,
    turn: float | np.ndarray = 0.0,
) -> StringMotion:
    """Move candidates along the hand's motion, from static equilibrium or from the
    state at its first tick.

    hand: one motion for all candidates, or one each. values: (C, P) parameters in the
    order of `string.parameters`. times: (F,), or (C, F) of their own, when the string
    is wanted [s]; before the hand's first tick nothing moves, after the last the hand
    rests. initial: how the string lies and moves at the first tick, whatever the time
    it names; in equilibrium without it. turn: on which side of the hand it hangs at
    rest, as of `hanging`. A candidate that does not stay finite, or whose stable step
    is impractically small, is rejected.

    Results do not depend on the number of threads nor on which candidates run together.
    """
    material = string.material(np.atleast_2d(values))
    position = (times - hand.start) / hand.tick
    last = last_needed_tick(position)
    count = int(last.max()) + 1
    poses, rates = append_rest_ticks(
        hand.pose[:, :count], hand.rate[:, :count], max(count - hand.pose.shape[1], 0)
    )
    steps, possible = steps_per_tick(
        *string.without_absent_effects(material), hand.tick
    )
    turn, parts = np.broadcast_to(turn, len(material)), []
    for level in np.unique(steps[possible]):  # those that share a step share the loop
        chosen = np.flatnonzero(possible & (steps == level))
        own = (each if len(each) == 1 else each[chosen] for each in (poses, rates))
        pose, rate = _free_string_pose(string, material[chosen], *own)
        begins = None if initial is None else initial.for_candidates(chosen)
        ticks = _run_candidates(
            string, material[chosen], pose, rate, hand, int(level), begins, turn[chosen]
        )
        asked_for, end = (
            (position, last) if times.ndim == 1 else (position[chosen], last[chosen])
        )
        points = interpolate_ticks(ticks, asked_for, end)
        longer = string.free_length_ratio(material[chosen])[:, None]
        # of strings that begin elsewhere: points at the stated arc lengths
        if np.any(longer != 1):
            tip = string.points - 1
            points = interpolate_along_string(
                points,
                np.minimum(
                    (np.arange(string.points) + (longer - 1) * tip) / longer, tip
                ),
            )
        parts.append((chosen, points, is_bounded(ticks, end)))
    return _gather_groups(parts, (len(material), times.shape[-1], string.points, 2))


def _gather_groups(
    parts: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]], shape: tuple[int, ...]
) -> StringMotion:
    """All candidates, from those that share a step: which they are, their points, and
    who stayed alive.
    """
    if len(parts) == 1 and len(parts[0][0]) == shape[0]:
        _, points, finite = parts[0]
    else:
        points, finite = np.full(shape, np.nan), np.zeros(shape[0], dtype=bool)
        for chosen, some, alive in parts:
            points[chosen], finite[chosen] = some, alive
    # a sum is not finite where a number is not
    with np.errstate(invalid="ignore", over="ignore"):
        finite = finite & np.isfinite(points.sum(axis=(1, 2, 3)))
    points[~finite] = np.nan
    return StringMotion(points, finite)


def _free_string_pose(
    string: String, material: np.ndarray, pose: np.ndarray, rate: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Poses of where the free string begins, and their rates, from those of the stated
    grasp, (1 or C, K, 3) each.
    """
    for along, across in string.law_values("grasp_offset", material, {}):
        if np.any(along) or np.any(across):
            cos, sin = np.cos(pose[..., 2]), np.sin(pose[..., 2])
            x, y = along * cos - across * sin, along * sin + across * cos
            pose = pose + np.stack([x, y, 0 * x], axis=-1)
            rate = rate + rate[..., 2:] * np.stack([-y, x, 0 * x], axis=-1)
    return pose, rate


def _run_candidates(
    string: String,
    material: np.ndarray,
    pose: np.ndarray,
    rate: np.ndarray,
    hand: HandMotion,
    steps: int,
    initial: StringState | None,
    turn: np.ndarray,
) -> np.ndarray:
    """Run candidates that share a step. Returns positions at the ticks (C, K, n, 2), of
    no meaning once one is lost.
    """
    count, (looped, filled) = len(material), string.with_compiled_effects(material)
    loop = (looped.effects, looped.row_names, string.integrator)
    width = kernel_codegen.lane_count(count, *loop)
    blocks = -(-count // width)
    # the last candidate again, where a block has lanes left
    index = np.minimum(np.arange(blocks * width), count - 1)
    # the loop loads a number of all candidates of a block at once: lanes stand last,
    # side by side
    parameters = np.ascontiguousarray(
        filled[index].reshape(blocks, width, -1).transpose(0, 2, 1)
    )
    own = pose if len(pose) == 1 else pose[index]
    angles, lengths, velocity, hung = (
        part[index]
        for part in _initial_configuration(string, material, pose, rate, initial, turn)
    )
    working, acting = string.without_absent_effects(material[index])
    chain = (
        working.point_masses(acting)[0],
        working.free_segment_lengths(acting),
        partial(averageable_slopes, working, acting),
    )
    constants = string.integrator.row_values(*chain, hand.tick / steps)
    let_back = (
        0.0
        if initial is None
        else np.broadcast_to(initial.memory_reversal, count)[index][:, None]
    )
    further = {
        **constants,
        **_memory_rows(string, material[index], own[:, 0, 2], angles, hung, let_back),
    }
    buffers = _fill_buffers(
        string, material[index], own[:, 0], angles, lengths, velocity, further, width
    )
    # one hand for all: its cubics are stored once, and not once a block
    shared = len(pose) == 1
    cubic = _hermite_coefficients(
        own, rate if shared else rate[index], hand.tick, width
    )
    out = np.empty((count, cubic.shape[0] + 1, string.points, 2))
    alive = np.ones((blocks, width), dtype=bool)
    run = partial(
        kernel_codegen.compile_step_loop(*loop, width),
        **{
            "P": parameters.reshape(blocks, -1),
            "per_block": 0 if shared else 1,
            "start": hand.start,
        },
        **{"points": string.points, "length": string.segment_length},
    )
    # at rest all velocities are the same: none
    if initial is not None and string.integrator.velocity_lag:
        _stagger_velocities(
            string, run, buffers, cubic, hand.tick / steps, steps, width
        )
    run(
        buffers,
        H=cubic,
        steps=np.full(blocks, steps),
        tick=hand.tick,
        out=out,
        alive=alive,
    )
    return out


def _initial_configuration(
    string: String,
    material: np.ndarray,
    pose: np.ndarray,
    rate: np.ndarray,
    initial: StringState | None,
    turn: np.ndarray,
) -> tuple[np.ndarray, ...]:
    """How strings lie and move at first: angles [rad] and lengths [m] of the segments,
    (C, n - 1) each, velocities of the points (C, n, 2) [m/s], and the angles at which
    hinges would hold nothing: where the string would hang at rest, if they hold
    anything.

    In equilibrium, or as `initial` says; then each candidate is stretched as it would
    be if it hung there at rest: let go without strain, a string would ring. turn: (C,),
    as of `hanging`.
    """
    if initial is None:
        angles, lengths = hanging_shape(
            *string.without_absent_effects(material), pose[:, 0], turn
        )
        return angles, lengths, np.zeros((len(material), string.points, 2)), angles
    shape = (len(material), string.points - 1)
    middles = string.segment_middles()
    if np.any(hidden := (string.free_length_ratio(material) - 1) * string.length):
        initial = initial.extend_before_grasp(
            hidden + grasp_compliance_length(string, material),
            pose[:, 0, 2],
            rate[:, 0, 2],
        )
        middles = (
            string.free_segment_lengths(material)[:, None] * (np.arange(shape[1]) + 0.5)
            - hidden[:, None]
        )
    angles, turns = (
        np.broadcast_to(each, shape)
        for each in initial.segment_angles_and_rates(middles)
    )
    lengths = stretched_lengths(string, material, pose[:, 0], angles)
    across = np.stack([-np.sin(angles), np.cos(angles)], axis=-1)
    relative = np.cumsum((lengths * turns)[..., None] * across, axis=1)
    hand = np.broadcast_to(rate[:, :1, :2], (len(material), 1, 2))
    velocity = np.concatenate([hand, hand + relative], axis=1)
    hung = (
        hanging_shape(*string.without_absent_effects(material), pose[:, 0], turn)[0]
        if any(map(string.memory_count, MEMORY_SLOTS))
        else angles
    )
    return angles, lengths, velocity, hung


def _stagger_velocities(
    string: String,
    run: Callable[..., None],
    buffers: np.ndarray,
    cubic: np.ndarray,
    dt: float,
    steps: int,
    width: int,
) -> None:
    """Velocities to the time at which the integrator keeps them, in place, by a step
    tried on a copy.

    With a the steps by which they are behind the positions, v(-a dt) = v(0) - a (v(dt)
    - v(0)).
    """
    blocks, nowhere = len(buffers), np.empty((0, 2, string.points, 2))
    first = cubic[:1] * np.repeat((1.0 / steps) ** (np.arange(12) % 4), width)
    after, alive = buffers.copy(), np.ones((blocks, width), dtype=bool)
    run(
        after,
        H=first,
        steps=np.ones(blocks, dtype=int),
        tick=dt,
        out=nowhere,
        alive=alive,
    )
    kinds = kernel_codegen.row_numbers(string.integrator, string.effects)
    rows = [kinds["VX"], kinds["VY"]]
    now, then = (
        each.reshape(blocks, -1, len(kinds), width) for each in (buffers, after)
    )
    now[:, :, rows] -= string.integrator.velocity_lag * (
        then[:, :, rows] - now[:, :, rows]
    )


def _fill_buffers(
    string: String,
    material: np.ndarray,
    pose: np.ndarray,
    angles: np.ndarray,
    lengths: np.ndarray,
    velocity: np.ndarray,
    constants: Mapping[str, np.ndarray],
    width: int,
) -> np.ndarray:
    """The kernel's rows, filled with the initial state.

    velocity: of the points, (C, n, 2) [m/s]. constants: further rows, of the integrator
    and of hinges with a memory, (C, 1 to n) each. width: candidates side by side.
    """
    blocks = len(material) // width
    vectors = lengths[..., None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    positions = np.cumsum(
        np.concatenate([np.zeros((len(material), 1, 2)), vectors], axis=1), axis=1
    )
    positions = positions + pose[:, None, :2]
    masses, cells = string.point_masses(material)
    rows = {
        "X": positions[..., 0],
        "Y": positions[..., 1],
        "ANGLE": angles,
        "SX": vectors[..., 0],
        "SY": vectors[..., 1],
        "INERTIA": 1.0 / masses,
        "WEIGHT": cells / masses,
        "VX": velocity[..., 0],
        "VY": velocity[..., 1],
        "SET": grasp_rest_angle(string, material),
    }
    buffers = kernel_codegen.zero_buffers(
        blocks, string.points, string.integrator, string.effects, width
    )
    kinds = kernel_codegen.row_numbers(string.integrator, string.effects)
    for name, data in {**rows, **constants}.items():
        lanes = data.reshape(blocks, width, -1).transpose(0, 2, 1)
        buffers[:, : data.shape[1], kinds[name]] = lanes
    return buffers.reshape(blocks, -1)


def _memory_rows(
    string: String,
    material: np.ndarray,
    theta: np.ndarray,
    angles: np.ndarray,
    hung: np.ndarray,
    let_back: float | np.ndarray,
) -> dict[str, np.ndarray]:
    """The kernel's rows for what has a memory: what hinges are bent to, and what they
    then hold, (C, n - 1) each; the grasp's comes first.

    theta: (1 or C,) of the hand [rad]. angles: (C, n - 1) of the segments [rad]; hung:
    those at which nothing is held, from which the string was pulled slowly. let_back:
    how far it was let back then, (C, 1) or all, as in `State`.
    """
    count = max(string.memory_count(slot) for slot in MEMORY_SLOTS)
    if not count:
        return {}
    chain = Chain.from_material(string, material)
    bent, before = (
        {
            "grasp_moment": grasp_hinge_angle(chain, theta, each),
            "moment": hinge_curvatures(chain, each),
        }
        for each in (angles, hung)
    )
    places = {"grasp_moment": slice(0, 1), "moment": slice(1, None)}
    rows = np.zeros((1 + count, *angles.shape))
    for slot, place in places.items():
        rows[0, :, place] = bent[slot]
        pulled = bent[slot] - before[slot]
        held = string.updated_memory(slot, material, pulled)
        # beside what is held after the pull, the most that would be held after it was
        # let back all the way
        other = string.updated_memory(
            slot, material, -FULL_REVERSAL_BEND * np.sign(pulled), held
        )
        for row, here, there in zip(rows[1:], held, other, strict=False):
            row[:, place] = here + let_back * (there - here)
    return dict(zip(("CURVED", *(f"HELD{i}" for i in range(count))), rows, strict=True))


def _hermite_coefficients(
    pose: np.ndarray, rate: np.ndarray, tick: float, width: int
) -> np.ndarray:
    """Coefficients of the cubic in each tick, for x, y, theta each a0..a3, as the loop
    reads them: of one hand for all, (K - 1, 1, 12 width), as wide as the lanes so that
    it loads vectors, or of the hands of each block.
    """
    p0, p1 = pose[:, :-1], pose[:, 1:]
    v0, v1 = rate[:, :-1] * tick, rate[:, 1:] * tick
    coefficients = np.stack(
        [p0, v0, 3 * (p1 - p0) - 2 * v0 - v1, 2 * (p0 - p1) + v0 + v1], axis=-1
    )
    hands, count = coefficients.shape[:2]
    cubic = np.ascontiguousarray(
        coefficients.reshape(hands, count, 12).transpose(1, 2, 0)
    )
    cubic = np.repeat(cubic, width, axis=2) if hands == 1 else cubic
    return (
        cubic.reshape(count, 12, -1, width)
        .transpose(0, 2, 1, 3)
        .reshape(count, -1, 12 * width)
    )
