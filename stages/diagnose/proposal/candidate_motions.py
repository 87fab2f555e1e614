"""Random motions of the arm, and synthetic trials of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from pydantic import Field

from stringcast.stages.generate.curves import Curves, first_curves, join_curves
from stringcast.stages.generate.generate import arm_faults
from stringcast.stages.inference.prepared_trial import PreparedTrial
from stringcast.stages.model.box import Box
from stringcast.stages.model.hand import JointMotion
from stringcast.stages.model.model import Model

# Violent casts are hard to simulate, so slower motions are tried, too
ACCELERATION_FACTORS = (1.0, 0.5, 0.25, 0.12)
MOTIONS_PER_DRAW = 512
MAX_DRAWS = 200
POINTS_PER_FRAME = 8  # they represent all measured points
MAX_FRAME_RATE_HZ = 100

PositiveNumber = Annotated[float, Field(gt=0)]
RestSeconds = Annotated[float, Field(ge=0, le=10)]


@dataclass(frozen=True)
class DesignSettings:
    """Settings of the search for the next motion.

    Attributes
    ----------
    shortest, longest : float
        Range of the movement time [s].
    alpha : float
        Limit of the random accelerations [rad/s^2].
    before, after : float
        Rest that is filmed around the movement [s].
    """

    motions: Annotated[int, Field(ge=1)]
    shortest: PositiveNumber
    longest: PositiveNumber
    alpha: PositiveNumber
    before: RestSeconds
    after: RestSeconds


def sample_motions_within_limits(
    model: Model,
    obstacles: Sequence[Box],
    design: DesignSettings,
    rng: np.random.Generator,
) -> Curves:
    """Sample random motions within the arm's limits.

    There are fewer than `design.motions` if hardly any motion is allowed.
    """
    arm = model.arm
    kept = []
    count = 0
    durations = (design.shortest, design.longest)
    factors = ACCELERATION_FACTORS
    share = -(-design.motions // len(factors))
    for number in range(MAX_DRAWS):
        alpha = design.alpha * factors[number % len(factors)]
        curves = first_curves(arm, rng, MOTIONS_PER_DRAW, durations, alpha)
        sampled = curves.sample(arm.tick, float(curves.duration.max()))
        is_allowed = arm_faults(arm, obstacles, *sampled) == ""
        allowed = np.flatnonzero(is_allowed)[:share]
        kept.append(curves.select(allowed))
        count += len(allowed)
        if count >= design.motions:
            break
    return join_curves(kept)


def synthetic_trial(
    model: Model,
    curve: Curves,
    like: PreparedTrial,
    design: DesignSettings,
) -> PreparedTrial:
    """Make the trial of a motion, with all points at the origin.

    Parameters
    ----------
    curve : Curves
        A single motion.
    like : PreparedTrial
        A measured trial, whose noise and arc lengths of points are used.
    """
    tick = model.arm.tick
    duration = float(curve.duration[0])
    # Sample beyond the end, because joints with a lag arrive later
    motion = JointMotion(0.0, tick, *curve.sample(tick, duration + design.after))
    fullest = like.frame == np.argmax(np.bincount(like.frame))
    measured = like.s[fullest]
    numbers = np.linspace(0, len(measured) - 1, POINTS_PER_FRAME).round().astype(int)
    places = measured[np.unique(numbers)]

    rate = min(MAX_FRAME_RATE_HZ, model.camera.fps)
    first = -round(design.before * rate)
    last = round((duration + design.after) * rate)
    times = np.arange(first, last + 1) / rate
    frame, s = np.meshgrid(np.arange(len(times)), places, indexing="ij")
    frame = frame.ravel()
    s = s.ravel()
    points = np.zeros((len(s), 2))
    sigma = np.full(len(s), float(np.median(like.sigma)))
    return PreparedTrial("proposed", model, motion, times, frame, s, points, sigma)


def with_represented_points(trial: PreparedTrial, like: PreparedTrial) -> PreparedTrial:
    """Reduce sigma of each synthetic point to that of all points it represents."""
    points_per_frame = len(like.s) / len(like.times) / (len(trial.s) / len(trial.times))
    frame_time = trial.times[1] - trial.times[0]
    represented = points_per_frame * trial.model.camera.fps * frame_time
    return replace(trial, sigma=trial.sigma / np.sqrt(max(represented, 1.0)))
