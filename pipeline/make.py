"""How a step is made: each calls its stage with what it may look at."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from stringcast.data.alignment import Alignment
from stringcast.data.artifacts import Diagnosis, Estimate, Motion, Observation, Points, Prediction, Trial
from stringcast.pipeline.steps import Past, step_seed
from stringcast.pipeline.world import World
from stringcast.stages.estimate.predict import predict
from stringcast.stages.estimate.untouched import untouched
from stringcast.stages.extract import aligned_footage
from stringcast.stages.progress import Progress


def make(name: str, world: World, past: Past, progress: Progress) -> Any:
    """A step's artifact, by a seed of its own."""
    return MAKERS[name](world, past, step_seed(world.seed, past.number, name), progress)


def _generate(world: World, past: Past, seed: int, progress: Progress) -> Motion:
    place = (world.model, world.target, world.obstacles)
    return world.stages["generate"](*place, past.motion, past.estimate, seed=seed, progress=progress)


def _excite(world: World, past: Past, seed: int, progress: Progress) -> Motion:
    return world.stages["excite"](world.model, world.obstacles, seed=seed, progress=progress)


def _execute(world: World, past: Past, seed: int, progress: Progress) -> Trial:
    lab = world.stages["hardware"](world.arm, world.camera, seed=world.seed, trial=past.number)
    planned = next(made for made in past.done.values() if isinstance(made, Motion))
    return world.stages["execute"](planned, lab.arm, lab.camera)


def _extract(world: World, past: Past, seed: int, progress: Progress) -> Points:
    film = past.done["execute"].film if past.film is None else past.film
    return world.stages["extract"](aligned_footage(film, world.model), world.camera, progress=progress)


def _estimate(world: World, past: Past, seed: int, progress: Progress) -> Estimate:
    return world.stages["estimate"](
        *(world.model, _explicable(world, past), past.estimate),
        **{"seed": seed, "manipulation": past.number, "progress": progress},
    )


def _predict(world: World, past: Past, seed: int, progress: Progress) -> Prediction:
    assert past.estimate is not None
    (observation,) = _explicable(world, past)
    return predict(world.model, past.estimate, observation, world.config["own"])


def _explicable(world: World, past: Past) -> list[Observation]:
    """What was seen of each trial until its string touched an obstacle."""
    return [untouched(observation, world.obstacles) for observation in past.observations]


def _align(world: World, past: Past, seed: int, progress: Progress) -> Alignment:
    return world.stages["align"](world.model, past.observations, past.films, progress=progress)


def _diagnose(world: World, past: Past, seed: int, progress: Progress) -> Diagnosis:
    given = (world.model, _explicable(world, past), past.rejected, past.held_out, world.obstacles)
    return world.stages["diagnose"](*given, seed=seed, progress=progress)


def _propose(world: World, past: Past, seed: int, progress: Progress) -> Motion:
    assert past.diagnosis is not None
    assert past.diagnosis.motion is not None
    return past.diagnosis.motion


MAKERS: Mapping[str, Callable[[World, Past, int, Progress], Any]] = {
    "generate": _generate,
    "excite": _excite,
    "execute": _execute,
    "extract": _extract,
    "estimate": _estimate,
    "predict": _predict,
    "align": _align,
    "diagnose": _diagnose,
    "propose": _propose,
}
