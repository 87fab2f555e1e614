"""Generate a motion that hits whatever the string may be: the highest chance over many
draws of it.

Random motions race, the winners are refined, and validation draws, which had no part in
choosing, say how likely the chosen motion hits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import pandas as pd
from pydantic import Field

from stringcast.data.artifacts import ATTEMPTS, MOTION_OUTCOME, Estimate, Motion
from stringcast.data.lazy_module import LazyModule
from stringcast.stages.common import Progress, SettingsGroup, partial_progress
from stringcast.stages.generate.curves import Curves, join_curves
from stringcast.stages.generate.generate import (
    HIT,
    MotionNotFoundError,
    MotionRanges,
    command_table,
    control_point_table,
    predicted_string_table,
)
from stringcast.stages.generate.hit_probability import (
    CastTask,
    midpoint_tip_path,
    predict_outcome,
    simulate_motions,
)
from stringcast.stages.generate.learning import predictive_sd
from stringcast.stages.generate.race import race_motions, sample_feasible_motions
from stringcast.stages.generate.refine import MotionSpace, refine_motions
from stringcast.stages.generate.uncertainty_samples import (
    PlanningUncertainty,
    UncertaintySamples,
    sample_uncertainty,
)
from stringcast.stages.hit_test import check_reach
from stringcast.stages.model.box import Box
from stringcast.stages.model.model import Model

stats = LazyModule("scipy.stats")

FINALIST_COUNT = 4  # winners of the race that are refined
NEAREST_MOTIONS = 8  # winners of the race that may be chosen all the same
SUFFICIENT_HIT_SHARE = 0.5  # of the draws hit: nothing else is sought


@dataclass(frozen=True)
class SearchResult:
    """Motions found, of how many tried, and the largest share of draws that one of
    those refined hits.
    """

    best: Curves
    tried: int
    share: float


@dataclass(frozen=True)
class SearchEffort(SettingsGroup):
    """Effort of the search. motions: random ones that race. string_samples: draws on which
    winners are refined, for `cma_iterations` of CMA-ES. max_restarts: from other random motions
    each, at most, while none found hits half of the draws; before the first trial, one.
    exploration: closeness (see `Outcome`) that may be given up for a more informative
    cast. validation: draws that had no part in the choice, for its hit probability.
    """

    motions: Annotated[int, Field(ge=16)]
    string_samples: Annotated[int, Field(ge=4)]
    cma_iterations: Annotated[int, Field(ge=0)]
    max_restarts: Annotated[int, Field(ge=1)]
    exploration: Annotated[float, Field(ge=0, le=1)]
    validation: Annotated[int, Field(ge=10)]


def generate(
    model: Model,
    target: Box,
    obstacles: Sequence[Box],
    previous: Motion | None,
    estimate: Estimate | None,
    *,
    seed: int,
    drawing: MotionRanges,
    search: SearchEffort,
    uncertainty: PlanningUncertainty,
    progress: Progress = lambda share: None,
) -> Motion:
    """The motion with the highest chance that the tip enters the target box, as far as
    is known.

    previous: the last motion; a quarter of those tried are slight changes of it.
    estimate: what is known of the string, None before the first trial. uncertainty: of
    all but the string. Raises MotionNotFoundError where the arm can make no motion or
    none is clear of the obstacles, and DataError for a target out of reach or an empty
    range of durations; a motion that hits with no draw is still the one that comes
    nearest.
    """
    space = MotionSpace(model.arm, *drawing.durations, drawing.alpha)
    check_reach(target, model.arm, model.string.length)
    rng = np.random.default_rng(seed)
    task = CastTask(model, target, obstacles)
    draws = sample_uncertainty(model, estimate, uncertainty, search.string_samples, rng)
    # half of all strings there may be are not hit by any motion
    most = 1 if estimate is None else search.max_restarts
    found: list[SearchResult] = []
    while len(found) < most and not any(
        each.share >= SUFFICIENT_HIT_SHARE for each in found
    ):
        random = sample_feasible_motions(
            task, space, previous, drawing.fraction, search.motions, rng
        )
        found.append(
            search_motions(
                task,
                space,
                random,
                draws,
                search.cma_iterations,
                seed,
                partial_progress(progress, len(found), most),
            )
        )
    final = join_curves([each.best for each in found])

    best = _choose_motion(
        task,
        final,
        sample_uncertainty(model, estimate, uncertainty, search.string_samples, rng),
        search.exploration,
    )
    progress(1.0)
    validation = sample_uncertainty(
        model, estimate, uncertainty, search.validation, rng
    )
    return build_motion_artifact(
        task,
        final.select(np.array([best])),
        validation,
        sum(each.tried for each in found),
    )


def _choose_motion(
    task: CastTask, final: Curves, fresh: UncertaintySamples, exploration: float
) -> int:
    """Number of the motion that comes nearest, or of one that is nearly so and teaches
    more. fresh: draws by which none was chosen. exploration: closeness that may be
    given for that.
    """
    closeness = predict_outcome(task, final, fresh).closeness
    best = int(np.argmax(closeness))
    near = np.flatnonzero(closeness >= closeness[best] - exploration)
    if len(near) > 1:
        best = int(
            near[
                np.argmin(
                    predictive_sd(
                        task,
                        final.select(near),
                        fresh,
                        int(np.searchsorted(near, best)),
                    )
                )
            ]
        )
    return best


def search_motions(
    task: CastTask,
    space: MotionSpace,
    random: Curves,
    draws: UncertaintySamples,
    rounds: int,
    seed: int,
    progress: Progress,
) -> SearchResult:
    """The best of random motions, and these refined; raises MotionNotFoundError where
    there is none.
    """
    if not len(random.duration):
        raise MotionNotFoundError(
            "no random motion keeps the arm's limits and clear of the obstacles. Widen them, or lower generate.alpha."
        )
    best = race_motions(task, random, draws)
    progress(0.4)
    refined = refine_motions(
        task, space, best.select(slice(FINALIST_COUNT)), draws, rounds, seed
    )
    progress(0.9)
    share = float(predict_outcome(task, refined, draws).hit.mean(axis=1).max())
    return SearchResult(
        join_curves([refined, best.select(slice(NEAREST_MOTIONS))]),
        len(random.duration),
        share,
    )


def build_motion_artifact(
    task: CastTask, curve: Curves, draws: UncertaintySamples, tried: int
) -> Motion:
    """The artifact of one movement, with its chance of hitting as these draws find it."""
    made = predict_outcome(task, curve, draws)
    hit, distance = (
        made.hit[0],
        np.where(made.hit[0] | (made.free_share[0] == 1), made.distance[0], np.inf),
    )
    if np.isinf(distance).all():
        raise MotionNotFoundError(
            f"on the best motion found, each of {len(hit)} likely strings touches an obstacle or cannot be simulated. "
            "Allow more generate.motions and generate.cma_iterations, or move the obstacles."
        )
    order = np.lexsort((distance, ~hit))  # those that hit come first, the nearest first
    typical = int(order[hit.sum() // 2])
    points = simulate_motions(task.model, curve, draws.select(np.array([typical])))[1][
        0
    ]
    target, way = task.target, midpoint_tip_path(points[None, :, -1])[0]
    at = int(np.argmin(target.distance_to_centre(way)))
    share = stats.binomtest(int(hit.sum()), len(hit)).proportion_ci(method="wilson")
    row = {
        "duration": float(curve.duration[0]),
        "t_hit": at * task.model.arm.tick / 2,
        **{"tip_x": way[at, 0], "tip_y": way[at, 1], "tried": tried},
        **{
            "target_x": target.x,
            "target_y": target.y,
            "target_w": target.w,
            "target_h": target.h,
        },
        **{
            "chance": float(hit.mean()),
            "chance_low": share.low,
            "chance_high": share.high,
        },
    }
    attempts = pd.DataFrame(
        {"outcome": ["less likely to hit", HIT], "count": [tried - 1, 1]}
    )
    return Motion(
        command_table(task.model.arm, curve),
        control_point_table(curve),
        predicted_string_table(
            np.arange(len(points)) * task.model.arm.tick,
            task.model.string.arc_lengths(),
            points,
        ),
        ATTEMPTS.check(attempts),
        MOTION_OUTCOME.check(pd.DataFrame([row])),
    )
