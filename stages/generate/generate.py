"""Generate a motion: try random ones until the simulated tip enters the target box."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import pandas as pd
from pydantic import Field

from stringcast.data.artifacts import (
    ATTEMPTS,
    COMMANDS,
    CONTROL_POINTS,
    JOINTS,
    MOTION_OUTCOME,
    PREDICTED_STRING,
    SPEEDS,
    Estimate,
    Motion,
)
from stringcast.data.errors import ExpectedError
from stringcast.data.schema import DataError
from stringcast.stages.common import Progress, SettingsGroup
from stringcast.stages.generate.curves import (
    INTERVALS,
    Curves,
    first_curves,
    next_curves,
)
from stringcast.stages.hit_test import check_reach
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.box import Box
from stringcast.stages.model.hand import JointMotion
from stringcast.stages.model.model import Model
from stringcast.stages.model.string import String
from stringcast.stages.spec import StageCall

# motions simulated at once: 90 MB of a string of 57 points for 1.5 s; after a hit no
# more are
BATCH_SIZE = 64
SUBSTEPS = 5  # looks at the tip in a tick: at 20 m/s it moves 20 mm between two
HIT = "hit"


class MotionNotFoundError(ExpectedError):
    """No motion was found in the budget; the message says why the tries failed and what
    to change.
    """


@dataclass(frozen=True)
class MotionRanges(SettingsGroup):
    """Settings by which motions are drawn. shortest, longest: range of T [s]. alpha:
    limit of the random accelerations [rad/s^2]. fraction: of the control points' range
    by which slight changes of the last motion differ.
    """

    shortest: Annotated[float, Field(gt=0)]
    longest: Annotated[float, Field(gt=0)]
    alpha: Annotated[float, Field(gt=0)]
    fraction: Annotated[float, Field(gt=0, le=1)]

    @property
    def durations(self) -> tuple[float, float]:
        """Range of T [s]. Raises DataError where it is empty."""
        if self.shortest > self.longest:
            ends = f"generate.shortest = {self.shortest} is above generate.longest = {self.longest}"
            raise DataError(f"{ends}. Change one of them.")
        return self.shortest, self.longest


@dataclass(frozen=True)
class SearchBudget(SettingsGroup):
    """attempts: motions of a kind tried at most. batch: of these at a time. hits:
    motions that hit, of which the one whose tip stays longest in the box is taken (1 is
    the paper's first come).
    """

    attempts: Annotated[int, Field(ge=1)]
    batch: Annotated[int, Field(ge=1)]
    hits: Annotated[int, Field(ge=1)]


@dataclass(frozen=True)
class SimulatedCandidates:
    """Simulated candidates. times: (F,) [s]. points: (C, F, n, 2) [m]. inside: (C, F -
    1) tip in the box.
    """

    times: np.ndarray
    points: np.ndarray
    inside: np.ndarray


def run(call: StageCall, motion: Motion | None, estimate: Estimate | None) -> Motion:
    """A motion at the target, by what was cast and estimated before; as a stage."""
    setup = call.setup
    given = (setup.model, setup.target, setup.obstacles, motion, estimate)
    made: Motion = call.by(*given, seed=call.seed, progress=call.progress)
    return made


def generate(
    model: Model,
    target: Box,
    obstacles: Sequence[Box],
    previous: Motion | None,
    estimate: Estimate | None,
    *,
    seed: int,
    drawing: MotionRanges,
    budget: SearchBudget,
    progress: Progress = lambda share: None,
) -> Motion:
    """A motion whose simulated tip hits the target during the movement.

    previous: the last motion, slightly changed from the second manipulation on; where
    no such change hits, any motion may (the paper does not say). estimate: of the
    string, None before the first trial. Raises MotionNotFoundError, and DataError for a
    target out of reach or an empty range of durations.
    """
    check_reach(target, model.arm, model.string.length)
    rng, count = np.random.default_rng(seed), Counter[str]()
    values = model.values({} if estimate is None else estimate.values())
    given = (drawing.durations, drawing.alpha)
    curves: list[Callable[[int], Curves]] = [
        lambda size: first_curves(model.arm, rng, size, *given)
    ]
    if previous is not None:
        last = (curves_from_motion(previous), drawing.fraction)
        curves.insert(0, lambda size: next_curves(model.arm, rng, size, *given, *last))
    for draw in curves:
        tried, found = Counter[str](), list[tuple[float, Motion]]()
        while tried.total() < budget.attempts and len(found) < budget.hits:
            size = min(budget.batch, budget.attempts - tried.total())
            found += _try_curves(
                model,
                target,
                obstacles,
                values,
                draw(size),
                tried,
                budget.hits - len(found),
            )
            progress(tried.total() / budget.attempts)
        count += tried
        if found:  # of several, the one whose tip stays longest in the box
            return _motion_with_counts(max(found, key=lambda one: one[0])[1], count)
    reasons = "; ".join(f"{reason}: {number}" for reason, number in count.most_common())
    raise MotionNotFoundError(
        f"no motion hits the target in {count.total()} tries ({reasons}). "
        "Allow more generate.attempts, a larger target box, or other limits of the arm."
    )


def _motion_with_counts(best: Motion, count: Counter[str]) -> Motion:
    """A motion with how many were tried, and what became of them."""
    attempts = ATTEMPTS.check(
        pd.DataFrame(sorted(count.items()), columns=["outcome", "count"])
    )
    return replace(
        best, attempts=attempts, outcome=best.outcome.assign(tried=count.total())
    )


def curves_from_motion(motion: Motion) -> Curves:
    """The curves of a motion found before."""
    control = motion.control_points.pivot(
        index="joint", columns="index", values="velocity"
    ).to_numpy()
    start = motion.commands[list(JOINTS)].iloc[:1].to_numpy()
    return Curves(start, np.array([motion.duration]), control[None])


def _try_curves(
    model: Model,
    target: Box,
    obstacles: Sequence[Box],
    values: np.ndarray,
    curves: Curves,
    count: Counter[str],
    wanted: int,
) -> list[tuple[float, Motion]]:
    """Check the arm, simulate what is allowed, and keep what hits, in the order drawn."""
    arm, until = model.arm, float(curves.duration.max())
    angles, speeds = curves.sample(arm.tick, until)
    reasons = arm_faults(arm, obstacles, angles, speeds)
    allowed = np.flatnonzero(reasons == "")
    found: list[tuple[float, Motion]] = []
    for first in range(0, len(allowed), BATCH_SIZE):
        some = allowed[first : first + BATCH_SIZE]
        seen = _simulate_curves(
            model, target, values, angles[some], speeds[some], until
        )
        reasons[some] = _string_faults(seen, obstacles, curves.duration[some])
        for index in np.flatnonzero(reasons[some] == HIT)[: wanted - len(found)]:
            found.append(
                _build_motion(
                    arm,
                    target,
                    model.string,
                    curves.select(some[[index]]),
                    seen,
                    int(index),
                )
            )
        if len(found) == wanted:
            count.update(reasons[: some[index] + 1])
            return found
    count.update(reasons)
    return found


def arm_faults(
    arm: Arm, obstacles: Sequence[Box], angles: np.ndarray, speeds: np.ndarray
) -> np.ndarray:
    """The limit of the arm that each movement violates, '' where none, (B,). Whole
    curves are checked.
    """
    reasons = np.full(len(angles), "", dtype=object)
    hand = np.linalg.norm(arm.grasp_velocity(angles, speeds)[..., :2], axis=-1)
    joints = arm.joint_positions(angles)
    change = (
        np.abs(np.diff(arm.commanded_velocities(angles), axis=1, prepend=0.0))
        / arm.tick
    )
    touched = [
        box.is_crossed_by(joints[..., :-1, :], joints[..., 1:, :]).any(axis=(1, 2))
        for box in obstacles
    ]
    checks = {
        "the arm touches an obstacle": np.any(touched, axis=0)
        if touched
        else np.zeros(len(angles), dtype=bool),
        "a joint accelerates too fast": (change > arm.acceleration).any(axis=(1, 2)),
        "the hand is too fast": (hand > arm.hand_speed).any(axis=1),
        "a joint is too fast": (np.abs(speeds) > arm.speed).any(axis=(1, 2)),
        "a joint leaves its range": (
            (angles < arm.lowest) | (angles > arm.highest)
        ).any(axis=(1, 2)),
    }
    for reason, bad in checks.items():
        reasons[bad] = reason
    return reasons


def _simulate_curves(
    model: Model,
    target: Box,
    values: np.ndarray,
    angles: np.ndarray,
    speeds: np.ndarray,
    until: float,
) -> SimulatedCandidates:
    """The strings of allowed movements."""
    tick = model.arm.tick
    times = np.arange(round(until / tick) * SUBSTEPS + 1) * tick / SUBSTEPS
    motion = model.simulate_string(
        JointMotion(0.0, tick, angles, speeds),
        np.repeat(values[None], len(angles), axis=0),
        times,
    )
    inside = target.is_crossed_by(motion.tip[:, :-1], motion.tip[:, 1:])
    return SimulatedCandidates(times, motion.points, inside)


def _string_faults(
    seen: SimulatedCandidates, obstacles: Sequence[Box], duration: np.ndarray
) -> np.ndarray:
    """Why each string fails, or HIT, (C,)."""
    reasons = np.full(len(duration), HIT, dtype=object)
    moving = seen.times[None, 1:] <= duration[:, None] + 1e-9
    for box in obstacles:
        touched = box.is_crossed_by(
            seen.points[:, 1:, :-1], seen.points[:, 1:, 1:]
        ).any(axis=2)
        reasons[(touched & moving).any(axis=1)] = "the string touches an obstacle"
    reasons[~(seen.inside & moving).any(axis=1)] = "the tip misses the target"
    reasons[~np.isfinite(seen.points).all(axis=(1, 2, 3))] = (
        "the simulation does not stay finite"
    )
    return reasons


def _build_motion(
    arm: Arm,
    target: Box,
    string: String,
    curve: Curves,
    seen: SimulatedCandidates,
    index: int,
) -> tuple[float, Motion]:
    """The artifact of one hit, and how long its tip stays in the box [s]."""
    duration = float(curve.duration[0])
    moving = seen.times[1:] <= duration + 1e-9
    inside = np.flatnonzero(seen.inside[index] & moving)
    tip = seen.points[index, 1:, -1]
    at = inside[int(np.argmin(target.distance_to_centre(tip[inside])))]
    outcome = {
        "duration": duration,
        "t_hit": seen.times[1 + at],
        **{"tip_x": tip[at, 0], "tip_y": tip[at, 1], "tried": 0},
        **{
            "target_x": target.x,
            "target_y": target.y,
            "target_w": target.w,
            "target_h": target.h,
        },
    }
    stay = len(inside) * (seen.times[1] - seen.times[0])
    ticks = np.flatnonzero(seen.times <= duration + 1e-9)[::SUBSTEPS]
    return stay, Motion(
        command_table(arm, curve),
        control_point_table(curve),
        predicted_string_table(
            seen.times[ticks], string.arc_lengths(), seen.points[index, ticks]
        ),
        ATTEMPTS.empty(),
        MOTION_OUTCOME.check(pd.DataFrame([outcome])),
    )


def command_table(arm: Arm, curve: Curves) -> pd.DataFrame:
    """Table COMMANDS of one movement: each velocity is the mean over the tick in which
    it is held.
    """
    angles = curve.sample(arm.tick, float(curve.duration[0]))[0][0]
    columns = {"t": np.arange(len(angles)) * arm.tick}
    columns |= dict(zip(JOINTS, angles.T, strict=True)) | dict(
        zip(SPEEDS, arm.commanded_velocities(angles).T, strict=True)
    )
    return COMMANDS.check(pd.DataFrame(columns))


def control_point_table(curve: Curves) -> pd.DataFrame:
    """Table CONTROL_POINTS of one movement."""
    joints, index = np.indices(curve.control.shape[1:])
    t = index * curve.duration[0] / INTERVALS
    columns = {
        "joint": joints.ravel() + 1,
        "index": index.ravel(),
        "t": t.ravel(),
        "velocity": curve.control[0].ravel(),
    }
    return CONTROL_POINTS.check(pd.DataFrame(columns))


def predicted_string_table(
    times: np.ndarray, arc: np.ndarray, points: np.ndarray
) -> pd.DataFrame:
    """Table PREDICTED_STRING. times: (T,) ticks [s]. arc: (n,) lengths [m]. points: (T,
    n, 2) as simulated [m].
    """
    t, s = np.meshgrid(times, arc, indexing="ij")
    columns = {
        "t": t.ravel(),
        "s": s.ravel(),
        "x": points[..., 0].ravel(),
        "y": points[..., 1].ravel(),
    }
    return PREDICTED_STRING.check(pd.DataFrame(columns))
