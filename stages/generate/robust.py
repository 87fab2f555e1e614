"""Choose the motion most likely to hit, over many samples of the string.

Random motions race and the winners are refined. Independent validation samples give the
hit probability of the chosen motion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
import pandas as pd
from pydantic import Field, NonNegativeInt, PositiveInt

from stringcast.data.artifacts import ATTEMPTS, MOTION_OUTCOME, Motion
from stringcast.data.estimates import Estimate
from stringcast.data.lazy_module import LazyModule
from stringcast.stages.common import Progress, SettingsGroup, partial_progress
from stringcast.stages.generate.curves import Curves, join_curves
from stringcast.stages.generate.generate import (
    HIT,
    MotionNotFoundError,
    MotionRanges,
    motion_artifact,
)
from stringcast.stages.generate.hit_probability import (
    CastTask,
    midpoint_tip_path,
    predict_outcome,
    simulate_motions,
)
from stringcast.stages.generate.learning import predictive_sd
from stringcast.stages.generate.mesh_correction import MeshCorrection
from stringcast.stages.generate.prospects import (
    UNLIKELY_HIT,
    describe_prospects,
    find_prospects,
)
from stringcast.stages.generate.race import race_motions, sample_feasible_motions
from stringcast.stages.generate.refine import MotionSpace, refine_motions
from stringcast.stages.generate.repeated_misfit import find_repeated_misfit
from stringcast.stages.generate.uncertainty_samples import (
    DrawUniforms,
    PlanningUncertainty,
    UncertaintySamples,
    independent_uniforms,
    sample_uncertainty,
    stratified_uniforms,
)
from stringcast.stages.hit_test import check_reach
from stringcast.stages.inference.mesh import EXTRAPOLATED_MESHES
from stringcast.stages.model.box import Box
from stringcast.stages.model.model import Model
from stringcast.stages.model.target import Target
from stringcast.stages.spec import declare_string_counts

stats = LazyModule("scipy.stats")

FINALIST_COUNT = 4  # winners of the race that are refined
RUNNER_UP_COUNT = 8  # winners of the race that may be chosen unrefined
SUFFICIENT_HIT_SHARE = 0.5  # share of the samples that ends the search
# simulated strings, counted in default runs
STRINGS_PER_RACING_MOTION = 12
STRINGS_PER_GENERATION = 48  # finalists of the race times CMA-ES population


@dataclass(frozen=True)
class SearchResult:
    """Result of one search.

    Parameters
    ----------
    best : motions from which one is chosen
    tried : number of random motions
    share : largest share of samples that a refined motion hits
    """

    best: Curves
    tried: int
    share: float


@dataclass(frozen=True)
class SearchEffort(SettingsGroup):
    """Effort of the search.

    Parameters
    ----------
    motions : number of random motions that race
    string_samples : number of samples on which winners are refined
    cma_iterations : number of iterations of the refinement
    max_restarts : largest number of searches; a search is repeated while no motion hits
        half of the samples, but not before the first trial
    exploration : closeness (see `CastOutcome`) that may be given up for a more
        informative cast
    validation : number of independent samples for the hit probability
    """

    motions: Annotated[int, Field(ge=16)]
    string_samples: Annotated[int, Field(ge=4)]
    cma_iterations: NonNegativeInt
    max_restarts: PositiveInt
    exploration: Annotated[float, Field(ge=0, le=1)]
    validation: Annotated[int, Field(ge=10)]


def _string_counts(settings: Mapping[str, Any]) -> Mapping[str, float]:
    searches = settings["max_restarts"]
    refined = settings["cma_iterations"] * settings["string_samples"]
    return {
        "motions": STRINGS_PER_RACING_MOTION * settings["motions"] * searches,
        "cma_iterations": STRINGS_PER_GENERATION * refined * searches,
        "validation": settings["validation"],
    }


@declare_string_counts(_string_counts)
def generate(
    model: Model,
    target: Target,
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
    """Generate the motion whose tip is most likely to hit the target.

    If no motion hits any sample, the nearest one is returned: the cast improves the
    estimate.

    Parameters
    ----------
    model : Model
        String and arm.
    target : Target
        Box that the tip should enter [m], with the wanted direction and speed.
    obstacles : sequence of Box
        Boxes [m] that the arm may not touch at all, and the string not before it hits.
    previous : Motion or None
        The last motion; a quarter of the random motions are changes of it.
    estimate : Estimate or None
        Latest estimate of the string.
    seed : int
        Seed of motions and samples.
    drawing : MotionRanges
        Ranges of the random motions.
    search : SearchEffort
        Effort of the search.
    uncertainty : PlanningUncertainty
        Uncertainty of arm and simulation.
    progress : callable
        Called with the completed share.

    Returns
    -------
    Motion
        Commands, predicted string, and outcome with its hit probability.

    Raises
    ------
    MotionNotFoundError
        If the arm can make no motion, or none avoids the obstacles.
    DataError
        If the target is out of reach or the range of durations is empty.
    """
    space = MotionSpace(model.arm, *drawing.durations, drawing.alpha)
    check_reach(target, model.arm, model.string.length)
    rng = np.random.default_rng(seed)
    misfit = find_repeated_misfit(model.arm, model.string.length, previous, estimate)
    mesh = None
    if estimate is not None and estimate.mesh_error_m > 0:
        values = model.values(estimate.values())
        mesh = MeshCorrection(values, EXTRAPOLATED_MESHES)
        misfit = None if misfit is None else misfit.without_mesh_error(estimate)
    task = CastTask(model, target, obstacles, misfit, mesh)

    def draw_samples(count: int, draw_uniforms: DrawUniforms) -> UncertaintySamples:
        known = (model, estimate, uncertainty)
        least_tip_error = uncertainty.tip if previous is None else 0.0
        return sample_uncertainty(*known, count, rng, draw_uniforms, least_tip_error)

    samples = draw_samples(search.string_samples, stratified_uniforms)
    # before the first trial no motion hits half of the possible strings
    max_searches = 1 if estimate is None else search.max_restarts
    results: list[SearchResult] = []
    for number in range(max_searches):
        random = sample_feasible_motions(
            task, space, previous, drawing.fraction, search.motions, rng
        )
        result = search_motions(
            task,
            space,
            random,
            samples,
            search.cma_iterations,
            seed,
            partial_progress(progress, number, max_searches),
        )
        results.append(result)
        if result.share >= SUFFICIENT_HIT_SHARE:
            break
    candidates = join_curves([result.best for result in results])
    choice_samples = draw_samples(search.string_samples, stratified_uniforms)
    best = _choose_motion(task, candidates, choice_samples, search.exploration)
    progress(1.0)
    validation = draw_samples(search.validation, independent_uniforms)
    motion = build_motion_artifact(
        task,
        candidates.select(np.array([best])),
        validation,
        sum(result.tried for result in results),
    )
    if motion.outcome["chance"].iloc[0] >= UNLIKELY_HIT:
        return motion
    prospects = find_prospects(task, candidates, best, samples, validation)
    outcome = motion.outcome.assign(**prospects)
    sentences = describe_prospects(outcome.iloc[0])
    outcome = MOTION_OUTCOME.check(outcome.assign(prospects=sentences))
    return replace(motion, outcome=outcome)


def _choose_motion(
    task: CastTask, candidates: Curves, samples: UncertaintySamples, exploration: float
) -> int:
    """Choose the most informative motion among those almost as close as the best.

    samples: new ones, which no motion was fitted to. exploration: closeness that may be
    given up.
    """
    closeness = predict_outcome(task, candidates, samples).closeness
    best = int(np.argmax(closeness))
    near = np.flatnonzero(closeness >= closeness[best] - exploration)
    if len(near) == 1:
        return best
    interest = int(np.searchsorted(near, best))
    tip_sd = predictive_sd(task, candidates.select(near), samples, interest)
    return int(near[np.argmin(tip_sd)])


def search_motions(
    task: CastTask,
    space: MotionSpace,
    random: Curves,
    samples: UncertaintySamples,
    iterations: int,
    seed: int,
    progress: Progress,
) -> SearchResult:
    """Find the best random motions and refine them.

    Parameters
    ----------
    task : CastTask
        Model, target and obstacles.
    space : MotionSpace
        Coordinates of the refinement.
    random : Curves
        Motions that the arm can make.
    samples : UncertaintySamples
        Samples of the uncertain quantities.
    iterations : int
        Number of iterations of the refinement.
    seed : int
        Seed of the refinement.
    progress : callable
        Called with the completed share.

    Returns
    -------
    SearchResult
        Refined motions first, then the winners of the race.

    Raises
    ------
    MotionNotFoundError
        If there are no random motions.
    """
    if not len(random.duration):
        raise MotionNotFoundError(
            "",
            "no random motion keeps the arm's limits and clear of the obstacles",
            "Widen the limits, or lower generate.alpha.",
        )
    # Finer meshes would take longer than the few samples of a race, and a third one as
    # long as those of a refinement
    race, refinement = replace(task, mesh=None), task
    if task.mesh is not None:
        mesh = replace(task.mesh, factors=EXTRAPOLATED_MESHES[:2])
        refinement = replace(task, mesh=mesh)
    winners = race_motions(race, random, samples)
    progress(0.4)
    finalists = winners.select(slice(FINALIST_COUNT))
    refined = refine_motions(refinement, space, finalists, samples, iterations, seed)
    progress(0.9)
    hit_shares = predict_outcome(task, refined, samples).hit.mean(axis=1)
    best = join_curves([refined, winners.select(slice(RUNNER_UP_COUNT))])
    return SearchResult(best, len(random.duration), float(hit_shares.max()))


def build_motion_artifact(
    task: CastTask, curve: Curves, samples: UncertaintySamples, tried: int
) -> Motion:
    """Build the artifact of one motion, with its hit probability under the samples.

    The predicted string is that of the median sample among those that hit, if any.
    """
    outcome = predict_outcome(task, curve, samples)
    hit = outcome.hit[0]
    is_usable = hit | (outcome.free_share[0] == 1)
    distance = np.where(is_usable, outcome.distance[0], np.inf)
    if np.isinf(distance).all():
        raise MotionNotFoundError(
            "",
            f"on the best motion found, each of {len(hit)} likely strings "
            "touches an obstacle or cannot be simulated",
            "Allow more generate.motions and generate.cma_iterations, or move "
            "the obstacles.",
        )
    by_hit_and_distance = np.lexsort((distance, ~hit))
    typical = samples.select(by_hit_and_distance[[hit.sum() // 2]])
    points = simulate_motions(task, curve, typical).points[0]
    path = midpoint_tip_path(points[None, :, -1])[0]
    tick = task.model.arm.tick
    distance = task.target.distance_to_centre(path)
    entered = np.append(False, task.target.is_entered_along(path, tick / 2))
    if task.target.restricts_arrival and entered.any():
        distance = np.where(entered, distance, np.inf)
    nearest = int(np.argmin(distance))
    interval = stats.binomtest(int(hit.sum()), len(hit)).proportion_ci(method="wilson")
    attempts = pd.DataFrame(
        {"outcome": ["less likely to hit", HIT], "count": [tried - 1, 1]}
    )
    return motion_artifact(
        task,
        curve,
        np.arange(len(points)) * tick,
        points,
        ATTEMPTS.check(attempts),
        t_hit=nearest * tick / 2,
        tip_x=path[nearest, 0],
        tip_y=path[nearest, 1],
        tried=tried,
        chance=float(hit.mean()),
        chance_low=interval.low,
        chance_high=interval.high,
        **describe_correction(task, curve, nearest * tick / 2),
    )


def describe_correction(
    task: CastTask, curve: Curves, t_hit: float
) -> dict[str, float]:
    """Return how much of the last cast's misfit a motion repeats at time t_hit [s]."""
    if task.misfit is None:
        return {}
    correlation = task.misfit.correlation(curve, float(curve.duration[0]))[0]
    tick = min(round(t_hit / task.model.arm.tick), len(correlation) - 1)
    misfit = task.misfit.tip_at_ticks(len(correlation))[tick]
    likeness = float(correlation[tick])
    return {
        "likeness": likeness,
        "correction": likeness * float(np.hypot(*misfit)),
    }
