"""Movements that the arm could make, as trials that nobody has made yet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from stringcast.stages.generate.curves import Curves, first_curves
from stringcast.stages.generate.generate import arm_faults
from stringcast.stages.inference.prepared_trial import PreparedTrial
from stringcast.stages.model.box import Box
from stringcast.stages.model.hand import JointMotion
from stringcast.stages.model.model import Model

# of the accelerations: a violent cast says little where its simulation is uncertain
ACCELERATION_FACTORS = (1.0, 0.5, 0.25, 0.12)
MOTIONS_PER_DRAW = 512  # at once
MAX_DRAWS = 200  # such draws at most
POINTS_PER_FRAME = 8  # on the string, that stand for all that are measured
RATED_FRAMES = 100  # a second, that stand for all that are filmed

PositiveNumber = Annotated[float, Field(gt=0)]
RestSeconds = Annotated[float, Field(ge=0, le=10)]


@dataclass(frozen=True)
class DesignSettings:
    """Which movements are considered. motions: how many. shortest, longest: range of T
    [s]. alpha: limit of the random accelerations [rad/s^2]. before, after: rest filmed
    around the movement [s].
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
    """Random movements within the arm's limits, fewer than wanted where hardly any is."""
    arm, found, count = model.arm, [], 0
    for number in range(MAX_DRAWS):
        alpha = design.alpha * ACCELERATION_FACTORS[number % len(ACCELERATION_FACTORS)]
        curves = first_curves(
            arm, rng, MOTIONS_PER_DRAW, (design.shortest, design.longest), alpha
        )
        sampled = curves.sample(arm.tick, float(curves.duration.max()))
        share = -(-design.motions // len(ACCELERATION_FACTORS))
        allowed = np.flatnonzero(arm_faults(arm, obstacles, *sampled) == "")[:share]
        found.append(curves.select(allowed))
        count += len(allowed)
        if count >= design.motions:
            break
    return Curves(
        *(
            np.concatenate([getattr(c, part) for c in found])
            for part in ("start", "duration", "control")
        )
    )


def synthetic_trial(
    model: Model, curve: Curves, like: PreparedTrial, design: DesignSettings
) -> PreparedTrial:
    """The trial that a movement would make: where points would be measured, and all of
    them at the origin.

    like: a trial that was made, whose places on the string and noise the new one has.
    Few points stand for many, and are as much more certain.
    """
    tick, duration = model.arm.tick, float(curve.duration[0])
    # joints that lag arrive later
    motion = JointMotion(0.0, tick, *curve.sample(tick, duration + design.after))
    fullest = like.frame == np.argmax(np.bincount(like.frame))
    measured = like.s[fullest]
    places = measured[
        np.unique(
            np.linspace(0, len(measured) - 1, POINTS_PER_FRAME).round().astype(int)
        )
    ]
    rate = min(RATED_FRAMES, model.camera.fps)
    times = (
        np.arange(
            -round(design.before * rate), round((duration + design.after) * rate) + 1
        )
        / rate
    )
    frame, s = (
        a.ravel() for a in np.meshgrid(np.arange(len(times)), places, indexing="ij")
    )
    sigma = np.full(len(s), float(np.median(like.sigma)))
    return PreparedTrial(
        "proposed", model, motion, times, frame, s, np.zeros((len(s), 2)), sigma
    )


def points_represented(model: Model, case: PreparedTrial, like: PreparedTrial) -> float:
    """How many points that would be measured one of an imagined trial stands for."""
    each = len(like.s) / len(like.times) / (len(case.s) / len(case.times))
    return each * model.camera.fps * (case.times[1] - case.times[0])
