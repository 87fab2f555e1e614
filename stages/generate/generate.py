"""Try random motions until the simulated tip enters the target box."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import pandas as pd
from pydantic import Field, PositiveFloat, PositiveInt

from stringcast.data.artifacts import (
    ATTEMPTS,
    COMMANDS,
    CONTROL_POINTS,
    JOINTS,
    MOTION_OUTCOME,
    PREDICTED_STRING,
    SPEEDS,
    Motion,
)
from stringcast.data.errors import ExpectedError
from stringcast.data.estimates import Estimate
from stringcast.data.schema import DataError
from stringcast.stages.common import Progress, SettingsGroup
from stringcast.stages.generate.curves import (
    INTERVALS,
    Curves,
    curves_from_motion,
    first_curves,
    next_curves,
)
from stringcast.stages.generate.hit_probability import CastTask
from stringcast.stages.hit_test import check_reach
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.box import Box
from stringcast.stages.model.extension import extend_model
from stringcast.stages.model.hand import JointMotion
from stringcast.stages.model.model import Model
from stringcast.stages.model.target import Target
from stringcast.stages.spec import StageCall, declare_string_counts

# motions simulated at once; 57 points for 1.5 s take 90 MB
BATCH_SIZE = 64
SUBSTEPS = 5  # samples of the tip in a tick; at 20 m/s they lie 20 mm apart
ROUNDING_S = 1e-9  # rounding error of times
HIT = "hit"


class MotionNotFoundError(ExpectedError):
    """No motion was found; the message states why, and what to change."""


@dataclass(frozen=True)
class MotionRanges(SettingsGroup):
    """Ranges of the random motions.

    Parameters
    ----------
    shortest, longest : range of the duration T [s]
    alpha : limit of the random accelerations [rad/s^2]
    fraction : largest change of a control point of the last motion, as a share of its
        range
    """

    shortest: PositiveFloat
    longest: PositiveFloat
    alpha: PositiveFloat
    fraction: Annotated[float, Field(gt=0, le=1)]

    def __post_init__(self) -> None:
        """Refuse an empty range of the duration."""
        if self.shortest > self.longest:
            raise DataError(
                "",
                f"generate.shortest = {self.shortest} is above generate.longest "
                f"= {self.longest}",
                "Change one of them.",
            )

    @property
    def durations(self) -> tuple[float, float]:
        """Range of T [s]."""
        return self.shortest, self.longest


@dataclass(frozen=True)
class SearchBudget(SettingsGroup):
    """Effort of the search.

    Parameters
    ----------
    attempts : largest number of changes of the last motion, and of new motions
    batch : number of motions drawn at a time
    hits : number of hits to find; the one whose tip stays longest in the box is taken
        (the paper takes the first)
    """

    attempts: PositiveInt
    batch: PositiveInt
    hits: PositiveInt


@dataclass(frozen=True)
class SimulatedCandidates:
    """Simulated strings of C motions.

    Parameters
    ----------
    times : (F,) [s]
    points : (C, F, n, 2) points of the strings [m]
    inside : (C, F - 1) whether the tip was in the target in the interval before each
        time, with the wanted direction and speed
    """

    times: np.ndarray
    points: np.ndarray
    inside: np.ndarray


def run(call: StageCall, motion: Motion | None, estimate: Estimate | None) -> Motion:
    """Generate a motion from the last cast and estimate."""
    setup = call.setup
    model = setup.model
    if motion is not None and not motion.is_cast:
        motion = None  # casts differ too much from a look
    if estimate is not None:
        # the estimate may include causes
        model = extend_model(model, estimate.values())
    task = (model, setup.target, setup.obstacles)
    return call.by(*task, motion, estimate, seed=call.seed, progress=call.progress)


@declare_string_counts(lambda given: {"attempts": given["attempts"]})
def generate(
    model: Model,
    target: Target,
    obstacles: Sequence[Box],
    previous: Motion | None,
    estimate: Estimate | None,
    *,
    seed: int,
    drawing: MotionRanges,
    budget: SearchBudget,
    progress: Progress = lambda share: None,
) -> Motion:
    """Generate a random motion whose simulated tip hits the target.

    From the second cast on, slight changes of the last motion are tried first. If none
    of them hits, new motions are tried; the paper does not specify this case.

    Parameters
    ----------
    model : Model
        String and arm.
    target : Target
        Box that the tip should enter [m], with the wanted direction and speed.
    obstacles : sequence of Box
        Boxes that arm and string may not touch [m].
    previous : Motion or None
        The last motion.
    estimate : Estimate or None
        Latest estimate of the string.
    seed : int
        Seed of the random motions.
    drawing : MotionRanges
        Ranges of the random motions.
    budget : SearchBudget
        Effort of the search.
    progress : callable
        Called with the share of attempts used.

    Returns
    -------
    Motion
        Commands, predicted string and outcome.

    Raises
    ------
    MotionNotFoundError
        If no attempt hits.
    DataError
        If the target is out of reach or the range of durations is empty.
    """
    check_reach(target, model.arm, model.string.length)
    rng = np.random.default_rng(seed)
    values = model.values({} if estimate is None else estimate.values())
    ranges = (drawing.durations, drawing.alpha)
    task = CastTask(model, target, obstacles)

    def draw_first(size: int) -> Curves:
        return first_curves(model.arm, rng, size, *ranges)

    kinds: list[Callable[[int], Curves]] = [draw_first]
    if previous is not None:
        last = curves_from_motion(previous)

        def draw_next(size: int) -> Curves:
            return next_curves(model.arm, rng, size, *ranges, last, drawing.fraction)

        kinds.insert(0, draw_next)
    counts = Counter[str]()
    for draw in kinds:
        tried = Counter[str]()
        hits: list[tuple[float, Motion]] = []
        while tried.total() < budget.attempts and len(hits) < budget.hits:
            size = min(budget.batch, budget.attempts - tried.total())
            wanted = budget.hits - len(hits)
            hits += _try_curves(task, values, draw(size), tried, wanted)
            progress(tried.total() / budget.attempts)
        counts += tried
        if hits:
            _, best = max(hits, key=lambda hit: hit[0])
            outcomes = pd.DataFrame(
                sorted(counts.items()), columns=["outcome", "count"]
            )
            return replace(
                best,
                attempts=ATTEMPTS.check(outcomes),
                outcome=best.outcome.assign(tried=counts.total()),
            )
    reasons = "; ".join(f"{reason}: {count}" for reason, count in counts.most_common())
    raise MotionNotFoundError(
        "",
        f"no motion hits the target in {counts.total()} tries ({reasons})",
        "Allow more generate.attempts, a larger target box, or other limits of "
        "the arm.",
    )


def _try_curves(
    task: CastTask,
    values: np.ndarray,
    curves: Curves,
    counts: Counter[str],
    wanted: int,
) -> list[tuple[float, Motion]]:
    """Simulate the motions that the arm can make, and return those that hit, in order.

    counts: number of motions by outcome, updated in place. wanted: number of hits to
    find. Returns, for each hit, how long the tip stays in the box [s] and the motion.
    """
    until = float(curves.duration.max())
    arm = task.model.arm
    angles, speeds = curves.sample(arm.tick, until)
    outcomes = arm_faults(arm, task.obstacles, angles, speeds)
    feasible = np.flatnonzero(outcomes == "")
    hits: list[tuple[float, Motion]] = []
    for first in range(0, len(feasible), BATCH_SIZE):
        batch = feasible[first : first + BATCH_SIZE]
        simulated = _simulate_curves(task, values, angles[batch], speeds[batch], until)
        durations = curves.duration[batch]
        outcomes[batch] = _string_faults(simulated, task.obstacles, durations)
        for index in np.flatnonzero(outcomes[batch] == HIT):
            curve = curves.select(batch[[index]])
            hits.append(_build_motion(task, curve, simulated, int(index)))
            if len(hits) == wanted:
                counts.update(outcomes[: batch[index] + 1])
                return hits
    counts.update(outcomes)
    return hits


def arm_faults(
    arm: Arm, obstacles: Sequence[Box], angles: np.ndarray, speeds: np.ndarray
) -> np.ndarray:
    """Name the limit of the arm that each motion violates.

    Parameters
    ----------
    arm : Arm
        The arm with its limits.
    obstacles : sequence of Box
        Boxes that the arm may not touch [m].
    angles : (B, K, J) array
        Joint angles at the ticks, past the end of each motion [rad].
    speeds : (B, K, J) array
        Joint speeds [rad/s].

    Returns
    -------
    (B,) array of str
        The violated limit, or an empty string.
    """
    faults = np.full(len(angles), "", dtype=object)
    for box in obstacles:
        touched = box.is_crossed_along(arm.joint_positions(angles))
        faults[touched.any(axis=(1, 2))] = "the arm touches an obstacle"
    velocity = arm.grasp_velocity(angles, speeds)
    hand = np.sqrt(velocity[..., 0] ** 2 + velocity[..., 1] ** 2)
    commanded = arm.commanded_velocities(angles)
    acceleration = np.abs(np.diff(commanded, axis=1, prepend=0.0)) / arm.tick
    outside = (angles < arm.lowest) | (angles > arm.highest)
    # a later entry overrides an earlier one
    checks = {
        "a joint accelerates too fast": (acceleration > arm.acceleration).any(axis=2),
        "the hand is too fast": hand > arm.hand_speed,
        "a joint is too fast": (np.abs(speeds) > arm.speed).any(axis=2),
        "a joint leaves its range": outside.any(axis=2),
    }
    for fault, violated in checks.items():
        faults[violated.any(axis=1)] = fault
    return faults


def _simulate_curves(
    task: CastTask,
    values: np.ndarray,
    angles: np.ndarray,
    speeds: np.ndarray,
    until: float,
) -> SimulatedCandidates:
    """Simulate the strings of feasible motions."""
    tick = task.model.arm.tick
    times = np.arange(round(until / tick) * SUBSTEPS + 1) * tick / SUBSTEPS
    motion = task.model.simulate_string(
        JointMotion(0.0, tick, angles, speeds),
        np.repeat(values[None], len(angles), axis=0),
        times,
    )
    inside = task.target.is_entered_along(motion.tip, tick / SUBSTEPS)
    return SimulatedCandidates(times, motion.points, inside)


def _string_faults(
    simulated: SimulatedCandidates, obstacles: Sequence[Box], duration: np.ndarray
) -> np.ndarray:
    """Name why each simulated string misses, or HIT, (C,). duration: (C,) [s]."""
    faults = np.full(len(duration), HIT, dtype=object)
    moving = simulated.times[None, 1:] <= duration[:, None] + ROUNDING_S
    points = simulated.points
    for box in obstacles:
        touched = box.is_crossed_along(points[:, 1:]).any(axis=2)
        faults[(touched & moving).any(axis=1)] = "the string touches an obstacle"
    hits = (simulated.inside & moving).any(axis=1)
    faults[~hits] = "the tip misses the target"
    finite = np.isfinite(points).all(axis=(1, 2, 3))
    faults[~finite] = "the simulation does not stay finite"
    return faults


def _build_motion(
    task: CastTask, curve: Curves, simulated: SimulatedCandidates, index: int
) -> tuple[float, Motion]:
    """Build the artifact of one hit, and measure how long its tip stays inside [s]."""
    times = simulated.times
    duration = float(curve.duration[0])
    moving = times <= duration + ROUNDING_S
    inside = np.flatnonzero(simulated.inside[index] & moving[1:])
    tip = simulated.points[index, 1:, -1]
    distance = task.target.distance_to_centre(tip[inside])
    nearest = inside[int(np.argmin(distance))]
    ticks = np.flatnonzero(moving)[::SUBSTEPS]
    motion = motion_artifact(
        task,
        curve,
        times[ticks],
        simulated.points[index, ticks],
        ATTEMPTS.empty(),
        t_hit=times[1 + nearest],
        tip_x=tip[nearest, 0],
        tip_y=tip[nearest, 1],
        tried=0,
    )
    return len(inside) * (times[1] - times[0]), motion


def motion_artifact(
    task: CastTask,
    curve: Curves,
    times: np.ndarray,
    points: np.ndarray,
    attempts: pd.DataFrame,
    **outcome: float,
) -> Motion:
    """Build the artifact of one motion.

    Parameters
    ----------
    task : CastTask
        Model, target and obstacles.
    curve : Curves
        The motion.
    times : (T,) array
        Ticks [s].
    points : (T, n, 2) array
        Predicted points of the string [m].
    attempts : table ATTEMPTS
        Outcomes of the motions that were tried.
    **outcome
        Further columns of table MOTION_OUTCOME.

    Returns
    -------
    Motion
        Commands, control points, predicted string, attempts and outcome.
    """
    model, target = task.model, task.target
    row = {
        "duration": float(curve.duration[0]),
        "target_x": target.x,
        "target_y": target.y,
        "target_w": target.w,
        "target_h": target.h,
    }
    return Motion(
        command_table(model.arm, curve),
        control_point_table(curve),
        _predicted_string_table(times, model.string.arc_lengths(), points),
        attempts,
        MOTION_OUTCOME.check(pd.DataFrame([row | outcome])),
    )


def command_table(arm: Arm, curve: Curves) -> pd.DataFrame:
    """Build table COMMANDS; a velocity is the mean over the tick that holds it."""
    angles = curve.sample(arm.tick, float(curve.duration[0]))[0][0]
    columns = {"t": np.arange(len(angles)) * arm.tick}
    columns |= zip(JOINTS, angles.T, strict=True)
    columns |= zip(SPEEDS, arm.commanded_velocities(angles).T, strict=True)
    return COMMANDS.check(pd.DataFrame(columns))


def control_point_table(curve: Curves) -> pd.DataFrame:
    """Build table CONTROL_POINTS of one motion."""
    joints, index = np.indices(curve.control.shape[1:])
    t = index * curve.duration[0] / INTERVALS
    columns = {
        "joint": joints.ravel() + 1,
        "index": index.ravel(),
        "t": t.ravel(),
        "velocity": curve.control[0].ravel(),
    }
    return CONTROL_POINTS.check(pd.DataFrame(columns))


def _predicted_string_table(
    times: np.ndarray, arc_lengths: np.ndarray, points: np.ndarray
) -> pd.DataFrame:
    t, s = np.meshgrid(times, arc_lengths, indexing="ij")
    columns = {
        "t": t.ravel(),
        "s": s.ravel(),
        "x": points[..., 0].ravel(),
        "y": points[..., 1].ravel(),
    }
    return PREDICTED_STRING.check(pd.DataFrame(columns))
