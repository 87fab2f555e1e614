"""`simulate` moves many candidates of a string at once along a hand's motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from stringcast.stages.model.engine import batching
from stringcast.stages.model.engine.kernel_codegen import row_numbers
from stringcast.stages.model.engine.law_slots import MEMORY_SLOTS
from stringcast.stages.model.engine.sampling import (
    interpolate_along_string,
    interpolate_ticks,
    is_bounded,
    last_needed_tick,
)
from stringcast.stages.model.engine.stability import (
    averageable_slopes,
    sampled_slopes,
    steps_per_tick,
)
from stringcast.stages.model.hand import HandMotion
from stringcast.stages.model.state import StringState
from stringcast.stages.model.statics.chain import (
    Chain,
    grasp_compliance_length,
    grasp_hinge_angle,
    grasp_rest_angle,
    hinge_curvatures,
    tangents_and_positions,
)
from stringcast.stages.model.statics.equilibrium import hanging_shape, stretched_lengths
from stringcast.stages.model.string import String

# [1/m] or [rad] by which a hinge is bent back to find its memory after a full reversal.
# No law's memory reaches further.
FULL_REVERSAL_BEND = 1e3


@dataclass(frozen=True)
class StringMotion:
    """Simulated strings at `String.arc_lengths` from the stated grasp.

    Parameters
    ----------
    points : ndarray of shape (C, F, n, 2)
        Positions [m], NaN where a run was rejected.
    finite : ndarray of bool, shape (C,)
        Whether each candidate was accepted.
    """

    points: np.ndarray
    finite: np.ndarray

    @property
    def tip(self) -> np.ndarray:
        """Positions of the tip, (C, F, 2) [m]."""
        return self.points[:, :, -1]


@dataclass(frozen=True)
class InitialConfiguration:
    """Initial shape and motion of strings.

    Parameters
    ----------
    angles, lengths : ndarray of shape (C, n - 1)
        Angles [rad] and lengths [m] of the segments.
    velocity : ndarray of shape (C, n, 2)
        Velocities of the points [m/s].
    rest_angles : ndarray of shape (C, n - 1)
        Angles at which the string would hang at rest, without memory [rad].
    is_at_rest : bool
        Whether the strings hang at rest.
    memory_reversal : float or ndarray of shape (C, 1)
        As `StringState.memory_reversal`.
    """

    angles: np.ndarray
    lengths: np.ndarray
    velocity: np.ndarray
    rest_angles: np.ndarray
    is_at_rest: bool
    memory_reversal: float | np.ndarray


def simulate(
    string: String,
    hand: HandMotion,
    values: np.ndarray,
    times: np.ndarray,
    initial: StringState | None = None,
    turn: float | np.ndarray = 0.0,
) -> StringMotion:
    """Move candidates of a string along the hand's motion.

    The result of a candidate depends neither on the number of threads nor on other
    candidates.

    Parameters
    ----------
    string : String
        The string and its effects.
    hand : HandMotion
        One motion for all candidates, or one each. After its last tick the hand rests.
    values : ndarray of shape (C, P) or (P,)
        Parameters of the candidates, in the order of `string.parameters`.
    times : ndarray of shape (F,) or (C, F)
        Times of the result [s]. Nothing moves before the hand's first tick.
    initial : StringState, optional
        State at the first tick; its own time is ignored. Without it the string hangs at
        rest.
    turn : float or ndarray of shape (C,)
        Side of the hand at rest, as in `hanging_shape` [rad].

    Returns
    -------
    StringMotion
        Points of the strings. A candidate that does not stay finite, or whose stable
        step is impractically small, is rejected.
    """
    material = string.material(np.atleast_2d(values))
    position = (times - hand.start) / hand.tick
    last = last_needed_tick(position)
    hand = hand.with_ticks(int(last.max()) + 1)
    active, active_material = string.without_absent_effects(material)
    slopes = sampled_slopes(active, active_material)
    steps, possible = steps_per_tick(active, active_material, hand.tick, slopes)
    gentlest = slopes[1]
    turn = np.broadcast_to(turn, len(material))

    points = np.empty((len(material), times.shape[-1], string.points, 2))
    finite = np.zeros(len(material), dtype=bool)
    for group_steps in np.unique(steps[possible]):
        chosen = np.flatnonzero(possible & (steps == group_steps))
        group_material = material[chosen]
        grasp = _free_string_hand(string, group_material, hand.for_candidates(chosen))
        if initial is None:
            start = _configuration_at_rest(string, group_material, grasp, turn[chosen])
        else:
            state = initial.for_candidates(chosen)
            start = _configuration_from_state(
                string, group_material, grasp, state, turn[chosen]
            )
        group_gentlest = gentlest[..., chosen]
        ticks = _run_candidates(
            string, group_material, group_gentlest, grasp, int(group_steps), start
        )
        end = last
        tick_positions = position
        if times.ndim == 2:
            end = last[chosen]
            tick_positions = position[chosen]
        at_times = interpolate_ticks(ticks, tick_positions, end)
        at_arc_lengths = _at_stated_arc_lengths(string, group_material, at_times)
        if len(chosen) == len(points):
            points = at_arc_lengths  # the usual case, without a copy
        else:
            points[chosen] = at_arc_lengths
        finite[chosen] = is_bounded(ticks, end)
    with np.errstate(invalid="ignore", over="ignore"):
        # A sum is finite only if all terms are.
        finite &= np.isfinite(points.sum(axis=(1, 2, 3)))
    points[~finite] = np.nan
    return StringMotion(points, finite)


def _at_stated_arc_lengths(
    string: String, material: np.ndarray, points: np.ndarray
) -> np.ndarray:
    """Interpolate free strings at the stated arc lengths."""
    ratio = string.free_length_ratio(material)[:, None]
    if np.all(ratio == 1):
        return points
    tip = string.points - 1
    hidden = (ratio - 1) * tip
    place = np.minimum((np.arange(string.points) + hidden) / ratio, tip)
    return interpolate_along_string(points, place)


def _free_string_hand(
    string: String, material: np.ndarray, hand: HandMotion
) -> HandMotion:
    """Move a hand from the stated grasp to the beginning of the free string."""
    pose, rate = hand.pose, hand.rate
    for along, across in string.law_values("grasp_offset", material, {}):
        if np.any(along) or np.any(across):
            cos, sin = np.cos(pose[..., 2]), np.sin(pose[..., 2])
            x = along * cos - across * sin
            y = along * sin + across * cos
            pose = pose + np.stack([x, y, 0 * x], axis=-1)
            rate = rate + rate[..., 2:] * np.stack([-y, x, 0 * x], axis=-1)
    return replace(hand, pose=pose, rate=rate)


def _run_candidates(
    string: String,
    material: np.ndarray,
    gentlest: np.ndarray,
    hand: HandMotion,
    steps: int,
    start: InitialConfiguration,
) -> np.ndarray:
    """Run candidates that share a step from their initial configuration.

    gentlest: smallest slopes of the laws, as in `sampled_slopes`, (2, 3, C).

    Returns positions at the ticks, (C, K, n, 2). They are meaningless after a candidate
    has diverged.
    """
    count = len(material)
    compiled, compiled_material = string.with_compiled_effects(material)
    loop = (compiled.effects, compiled.row_names, string.integrator)
    lanes = batching.lane_count(count, *loop)
    dt = hand.tick / steps
    first_pose = hand.pose[:, 0]
    rows = {
        **_configuration_rows(first_pose, start),
        **_constant_rows(string, material, gentlest, dt),
        **_memory_rows(compiled, compiled_material, first_pose[:, 2], start),
    }
    numbers = row_numbers(string.integrator, compiled.effects)
    buffers = _fill_buffers(numbers, rows, string.points, lanes)
    cubic = _hermite_coefficients(hand, lanes)
    run = partial(
        batching.compile_step_loop(*loop, lanes),
        values=_by_lane(compiled_material, lanes),
        hands_per_block=int(len(hand.pose) > 1),
        start=hand.start,
        points=string.points,
        length=string.segment_length,
    )

    # Stored velocities lag behind positions. One step of a copy gives v(-lag dt) = v(0)
    # - lag (v(dt) - v(0)). At rest all are zero.
    lag = string.integrator.velocity_lag
    if lag and not start.is_at_rest:
        powers = (1.0 / steps) ** (np.arange(12) % 4)
        first_step = cubic[:1] * np.repeat(powers, lanes)
        stepped = buffers.copy()
        ignored = np.empty((0, 2, string.points, 2))
        run(stepped, hands=first_step, steps=1, tick=dt, out=ignored)
        velocity = [numbers["VX"], numbers["VY"]]
        change = stepped[:, :, velocity] - buffers[:, :, velocity]
        buffers[:, :, velocity] -= lag * change

    out = np.empty((count, len(cubic) + 1, string.points, 2))
    run(buffers, hands=cubic, steps=steps, tick=hand.tick, out=out)
    return out


def _by_lane(rows: np.ndarray, lanes: int) -> np.ndarray:
    """Arrange candidates in lanes: from (C, M) to (blocks, M, lanes).

    Copies of the last candidate fill the last block.
    """
    blocks = -(-len(rows) // lanes)
    index = np.minimum(np.arange(blocks * lanes), len(rows) - 1)
    side_by_side = rows[index].reshape(blocks, lanes, -1).transpose(0, 2, 1)
    return np.ascontiguousarray(side_by_side)


def _configuration_at_rest(
    string: String, material: np.ndarray, hand: HandMotion, turn: np.ndarray
) -> InitialConfiguration:
    """Find the configuration at rest at the hand's first pose."""
    active, active_material = string.without_absent_effects(material)
    angles, lengths = hanging_shape(active, active_material, hand.pose[:, 0], turn)
    velocity = np.zeros((len(material), string.points, 2))
    return InitialConfiguration(
        angles, lengths, velocity, angles, is_at_rest=True, memory_reversal=0.0
    )


def _configuration_from_state(
    string: String,
    material: np.ndarray,
    hand: HandMotion,
    state: StringState,
    turn: np.ndarray,
) -> InitialConfiguration:
    """Find the configuration in a state.

    Each candidate has the stretch of static equilibrium in that shape, because a string
    released without strain would ring.
    """
    count, segments = len(material), string.points - 1
    pose, rate = hand.pose[:, 0], hand.rate[:, 0]
    middles = string.segment_middles()
    hidden = (string.free_length_ratio(material) - 1) * string.length
    if np.any(hidden):
        before = hidden + grasp_compliance_length(string, material)
        state = state.extend_before_grasp(before, pose[:, 2], rate[:, 2])
        segment_length = string.free_segment_lengths(material)[:, None]
        middles = segment_length * (np.arange(segments) + 0.5) - hidden[:, None]
    angles, turn_rates = state.segment_angles_and_rates(middles)
    angles = np.broadcast_to(angles, (count, segments))
    turn_rates = np.broadcast_to(turn_rates, (count, segments))
    lengths = stretched_lengths(string, material, pose, angles)

    normal = np.stack([-np.sin(angles), np.cos(angles)], axis=-1)
    relative = np.cumsum((lengths * turn_rates)[..., None] * normal, axis=1)
    hand_velocity = np.broadcast_to(rate[:, None, :2], (count, 1, 2))
    velocity = np.concatenate([hand_velocity, hand_velocity + relative], axis=1)

    rest_angles = angles
    if any(string.memory_count(slot) for slot in MEMORY_SLOTS):
        rest_angles = _configuration_at_rest(string, material, hand, turn).angles
    reversal = np.reshape(state.memory_reversal, (-1, 1))
    return InitialConfiguration(
        angles,
        lengths,
        velocity,
        rest_angles,
        is_at_rest=False,
        memory_reversal=reversal,
    )


def _configuration_rows(
    pose: np.ndarray, start: InitialConfiguration
) -> dict[str, np.ndarray]:
    """Compute the kernel's rows of position and velocity, (C, n - 1 or n) each.

    pose: pose of the grasp, (1 or C, 3) [m], [m], [rad].
    """
    count = len(start.angles)
    tangent, free_positions = tangents_and_positions(pose, start.angles, start.lengths)
    vectors = start.lengths[..., None] * tangent
    grasp = np.broadcast_to(pose[:, None, :2], (count, 1, 2))
    positions = np.concatenate([grasp, free_positions], axis=1)
    return {
        "X": positions[..., 0],
        "Y": positions[..., 1],
        "ANGLE": start.angles,
        "SEGMENT_X": vectors[..., 0],
        "SEGMENT_Y": vectors[..., 1],
        "VX": start.velocity[..., 0],
        "VY": start.velocity[..., 1],
    }


def _constant_rows(
    string: String, material: np.ndarray, gentlest: np.ndarray, dt: float
) -> dict[str, np.ndarray]:
    """Compute the rows that the loop only reads, (C, 1 to n) each.

    gentlest: as in `_run_candidates`. dt: step [s].
    """
    active, active_material = string.without_absent_effects(material)
    masses, cells = active.point_masses(active_material)
    constants = string.integrator.row_values(
        masses,
        active.free_segment_lengths(active_material),
        partial(averageable_slopes, active, active_material, gentlest),
        dt,
    )
    return {
        **constants,
        "INVERSE_MASS": 1.0 / masses,
        "LENGTH_PER_MASS": cells / masses,
        "GRASP_REST_ANGLE": grasp_rest_angle(string, material),
    }


def _fill_buffers(
    numbers: Mapping[str, int], rows: Mapping[str, np.ndarray], points: int, lanes: int
) -> np.ndarray:
    """Fill the kernel's buffers with rows (C, 1 to n), by name.

    Buffers are (blocks, points, rows, lanes). Rows that are not given are zero.

    numbers: numbers of the rows, by name.
    """
    blocks = -(-len(rows["X"]) // lanes)
    padded = points + batching.PADDING_POINTS
    buffers = batching.aligned_zeros((blocks, padded, len(numbers), lanes))
    for name, row in rows.items():
        buffers[:, : row.shape[1], numbers[name]] = _by_lane(row, lanes)
    return buffers


def _memory_rows(
    string: String,
    material: np.ndarray,
    theta: np.ndarray,
    start: InitialConfiguration,
) -> dict[str, np.ndarray]:
    """Find the initial bend and memory of hinges, (C, n - 1) each, grasp first.

    The string was pulled slowly from its rest angles, where it has no memory, to its
    initial angles.

    theta: direction of the hand, (1 or C,) [rad].
    """
    count = max(string.memory_count(slot) for slot in MEMORY_SLOTS)
    if not count:
        return {}
    chain = Chain.from_material(string, material)
    bends = {
        "grasp_moment": (slice(0, 1), partial(grasp_hinge_angle, chain, theta)),
        "moment": (slice(1, None), partial(hinge_curvatures, chain)),
    }
    names = ["LAST_CURVATURE", *(f"MEMORY{i}" for i in range(count))]
    rows = {name: np.zeros(start.angles.shape) for name in names}
    for slot, (hinges, bend) in bends.items():
        bent = bend(start.angles)
        pulled = bent - bend(start.rest_angles)
        rows["LAST_CURVATURE"][:, hinges] = bent
        pulled_memory = string.updated_memory(slot, material, pulled)
        # The memory after a full reversal.
        back = -FULL_REVERSAL_BEND * np.sign(pulled)
        reversed_memory = string.updated_memory(slot, material, back, pulled_memory)
        for i, memory in enumerate(pulled_memory):
            change = reversed_memory[i] - memory
            rows[f"MEMORY{i}"][:, hinges] = memory + start.memory_reversal * change
    return rows


def _hermite_coefficients(hand: HandMotion, lanes: int) -> np.ndarray:
    """Find the coefficients of the hand's cubic in each tick, as the loop reads them.

    They are a0 to a3 for x, y and theta each, (K - 1, blocks, 12 lanes). If all
    candidates share one hand, there is one block with copies in all lanes, so that the
    loop loads vectors.
    """
    p0, p1 = hand.pose[:, :-1], hand.pose[:, 1:]
    v0, v1 = hand.rate[:, :-1] * hand.tick, hand.rate[:, 1:] * hand.tick
    second = 3 * (p1 - p0) - 2 * v0 - v1
    third = 2 * (p0 - p1) + v0 + v1
    coefficients = np.stack([p0, v0, second, third], axis=-1)
    hands, ticks = coefficients.shape[:2]
    if hands == 1:
        one = coefficients.reshape(ticks, 1, 12)
        return np.repeat(one, lanes, axis=2)
    blocks = _by_lane(coefficients.reshape(hands, -1), lanes)
    by_tick = blocks.reshape(-1, ticks, 12 * lanes).swapaxes(0, 1)
    return np.ascontiguousarray(by_tick)
