"""How a step is made: each calls its stage with what it may look at."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from stringcast.data.alignment import Alignment
from stringcast.data.artifacts import Diagnosis, Estimate, Motion, Observation, Points, Prediction, Trial
from stringcast.pipeline.experiment import Experiment
from stringcast.pipeline.steps import Past, step_seed
from stringcast.stages.common import Progress
from stringcast.stages.estimate.predict import predict
from stringcast.stages.estimate.untouched import untouched
from stringcast.stages.extract import aligned_footage


def make(name: str, experiment: Experiment, past: Past, progress: Progress) -> Any:
    """A step's artifact, by a seed of its own."""
    return MAKERS[name](experiment, past, step_seed(experiment.seed, past.number, name), progress)


def _generate(experiment: Experiment, past: Past, seed: int, progress: Progress) -> Motion:
    place = (experiment.model, experiment.target, experiment.obstacles)
    return experiment.stages["generate"](*place, past.motion, past.estimate, seed=seed, progress=progress)


def _excite(experiment: Experiment, past: Past, seed: int, progress: Progress) -> Motion:
    return experiment.stages["excite"](experiment.model, experiment.obstacles, seed=seed, progress=progress)


def _execute(experiment: Experiment, past: Past, seed: int, progress: Progress) -> Trial:
    lab = experiment.stages["hardware"](experiment.arm, experiment.camera, seed=experiment.seed, trial=past.number)
    planned = next(made for made in past.done.values() if isinstance(made, Motion))
    return experiment.stages["execute"](planned, lab.arm, lab.camera)


def _extract(experiment: Experiment, past: Past, seed: int, progress: Progress) -> Points:
    film = past.done["execute"].film if past.film is None else past.film
    return experiment.stages["extract"](aligned_footage(film, experiment.model), experiment.camera, progress=progress)


def _estimate(experiment: Experiment, past: Past, seed: int, progress: Progress) -> Estimate:
    return experiment.stages["estimate"](
        *(experiment.model, _explicable(experiment, past), past.estimate),
        **{"seed": seed, "manipulation": past.number, "progress": progress},
    )


def _predict(experiment: Experiment, past: Past, seed: int, progress: Progress) -> Prediction:
    assert past.estimate is not None
    (observation,) = _explicable(experiment, past)
    return predict(experiment.model, past.estimate, observation, experiment.config["own"])


def _explicable(experiment: Experiment, past: Past) -> list[Observation]:
    """What was seen of each trial until its string touched an obstacle."""
    return [untouched(observation, experiment.obstacles) for observation in past.observations]


def _align(experiment: Experiment, past: Past, seed: int, progress: Progress) -> Alignment:
    return experiment.stages["align"](experiment.model, past.observations, past.films, progress=progress)


def _diagnose(experiment: Experiment, past: Past, seed: int, progress: Progress) -> Diagnosis:
    given = (experiment.model, _explicable(experiment, past), past.rejected, past.held_out, experiment.obstacles)
    return experiment.stages["diagnose"](*given, seed=seed, progress=progress)


def _propose(experiment: Experiment, past: Past, seed: int, progress: Progress) -> Motion:
    assert past.diagnosis is not None
    assert past.diagnosis.motion is not None
    return past.diagnosis.motion


MAKERS: Mapping[str, Callable[[Experiment, Past, int, Progress], Any]] = {
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
