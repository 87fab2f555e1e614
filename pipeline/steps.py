"""The steps of an iteration, and what each may look at; `pipeline.make` makes them."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from stringcast.data.alignment import Alignment
from stringcast.data.artifacts import Diagnosis, Estimate, Film, Motion, Observation, Points, Prediction, Trial


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
    """kind: the artifact it makes.

    What it looks at: uses: blocks of the settings. this, last: steps of this and of the last iteration.
    observes: trials and their points, this one's and those before it within memory.
    """

    kind: type
    uses: tuple[str, ...]
    this: tuple[str, ...] = ()
    last: tuple[str, ...] = ()
    observes: bool = False


def step_seed(seed: int, number: int, name: str) -> int:
    """A seed of its own for each step of each iteration."""
    return int.from_bytes(hashlib.sha256(f"{seed}/{number}/{name}".encode()).digest()[:4], "big")


MODEL = ("arm", "camera", "string", "effects", "known")
STEPS: dict[str, Step] = {
    "generate": Step(Motion, (*MODEL, "target", "obstacles", "generate", "seed"), last=("generate", "estimate")),
    "excite": Step(Motion, (*MODEL, "obstacles", "excite", "seed")),
    "execute": Step(Trial, ("arm", "camera", "hardware", "execute", "seed"), this=("generate",)),
    "extract": Step(Points, ("arm", "camera", "effects", "known", "extract"), this=("execute",)),
    "estimate": Step(Estimate, (*MODEL, "obstacles", "estimate", "memory", "seed"), last=("estimate",), observes=True),
    "predict": Step(Prediction, (*MODEL, "obstacles", "own"), last=("estimate", "predict"), observes=True),
    "align": Step(Alignment, (*MODEL, "align"), this=("execute",)),
    "diagnose": Step(Diagnosis, (*MODEL, "obstacles", "diagnose", "seed"), observes=True),
    "propose": Step(Motion, (), last=("diagnose",)),
}
