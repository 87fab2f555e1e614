"""The steps of an iteration: what each needs, and how it calls its stage."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from data.alignment import Alignment
from data.artifacts import Diagnosis, Estimate, Film, Motion, Observation, Points, Trial
from pipeline.world import World
from stages.estimate.untouched import untouched
from stages.extract import aligned_footage
from stages.progress import Progress


@dataclass(frozen=True)
class Past:
    """What a step may look at: earlier iterations, earlier steps of this one, and what was stored elsewhere.

    film: the trial's frames there, films: those of all of them, by trial. hashes: of the files there. rejected: its
    trials that cannot be used, with the reason. held_out: those that are to measure a gain. diagnosis: the last one.
    """

    number: int
    done: Mapping[str, Any]
    motion: Motion | None
    estimate: Estimate | None
    observations: tuple[Observation, ...]
    film: Film | None = None
    hashes: Mapping[str, str] = field(default_factory=dict)
    rejected: Mapping[str, str] = field(default_factory=dict)
    held_out: tuple[str, ...] = ()
    diagnosis: Diagnosis | None = None
    films: Mapping[str, Film] = field(default_factory=dict)


@dataclass(frozen=True)
class Step:
    """kind: the artifact it makes. make: how, from the world, the past, a seed and a progress report.

    What it looks at: uses: blocks of the settings. this, last: steps of this and of the last iteration.
    observes: trials and their points, this one's and those before it within memory.
    """

    kind: type
    make: Callable[[World, Past, int, Progress], Any]
    uses: tuple[str, ...]
    this: tuple[str, ...] = ()
    last: tuple[str, ...] = ()
    observes: bool = False


def step_seed(seed: int, number: int, name: str) -> int:
    """A seed of its own for each step of each iteration."""
    return int.from_bytes(hashlib.sha256(f"{seed}/{number}/{name}".encode()).digest()[:4], "big")


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


MODEL = ("arm", "camera", "string", "effects", "known")
STEPS: dict[str, Step] = {
    "generate": Step(
        *(Motion, _generate, (*MODEL, "target", "obstacles", "generate", "seed")), last=("generate", "estimate")
    ),
    "excite": Step(Motion, _excite, (*MODEL, "obstacles", "excite", "seed")),
    "execute": Step(Trial, _execute, ("arm", "camera", "hardware", "execute", "seed"), this=("generate",)),
    "extract": Step(Points, _extract, ("arm", "camera", "effects", "known", "extract"), this=("execute",)),
    "estimate": Step(
        Estimate, _estimate, (*MODEL, "obstacles", "estimate", "memory", "seed"), last=("estimate",), observes=True
    ),
    "align": Step(Alignment, _align, (*MODEL, "align"), this=("execute",)),
    "diagnose": Step(Diagnosis, _diagnose, (*MODEL, "obstacles", "diagnose", "seed"), observes=True),
    "propose": Step(Motion, _propose, (), last=("diagnose",)),
}
