"""The same cord at equal accuracy: each contender at the cheapest resolution that shows
the tip within a pixel.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from stringcast.stages.model.engine.accuracy import richardson_limit
from stringcast.stages.model.engine.simulate import simulate
from tests.speed.mujoco_chain import Chain
from tests.speed.pyelastica_rod import Rods
from tests.speed.trial import TIMES, cord_string, engine_tip, hand, tip_error

Resolution = tuple[int, float]  # points, links or elements; step [s]


@dataclass(frozen=True)
class Contender:
    """One way to simulate the cord.

    tip: at a resolution, (F, 2) [m]. converged: two resolutions for its limit. choices:
    to choose from. work: simulate so many cords at a resolution on so many threads.
    counts: how many at once.
    """

    name: str
    tip: Callable[[int, float], np.ndarray]
    converged: tuple[Resolution, Resolution]
    choices: Sequence[Resolution]
    work: Callable[[Resolution, int, int], object]
    counts: Sequence[int]

    def limit(self) -> np.ndarray:
        """(F, 2) the tip that it converges to [m]."""
        return richardson_limit(
            *(self.tip(*resolution) for resolution in self.converged)
        )


@dataclass(frozen=True)
class Entry:
    """A contender at its chosen resolution. error: of the tip [m]; apart: of its limit
    from the engine's [m].
    """

    contender: Contender
    resolution: Resolution
    error: float
    apart: float

    def run(self, count: int, threads: int = 1) -> None:
        """Simulate so many cords."""
        self.contender.work(self.resolution, count, threads)


def _engine(resolution: Resolution, count: int, threads: int) -> object:
    string, values = cord_string(*resolution)
    return simulate(string, hand(), np.tile(values, (count, 1)), TIMES)


COUNTS = (1, 16, 256)
STEPS = (1e-3, 5e-4, 2.5e-4, 1.25e-4)
ENGINE = Contender(
    "engine",
    engine_tip,
    ((25, 5e-5), (49, 5e-5)),
    list(product(range(12, 41, 2), (2e-3, *STEPS))),
    _engine,
    COUNTS,
)
MUJOCO = Contender(
    "MuJoCo",
    lambda links, step: Chain(links, step).rollout(1, 1)[0],
    ((20, 2.5e-5), (40, 2.5e-5)),
    list(product(range(12, 41, 2), (2.5e-3, 5e-3 / 3, 1.25e-3, *STEPS))),
    lambda resolution, count, threads: Chain(*resolution).rollout(count, threads),
    COUNTS,
)
PYELASTICA = Contender(
    "PyElastica",
    lambda elements, step: Rods(elements, step).rollout(1)[0],
    ((20, 5e-5), (40, 5e-5)),
    list(product(range(6, 33, 2), STEPS[2:])),
    lambda resolution, count, threads: Rods(*resolution).rollout(count),
    (8,),
)


def entries(most: float) -> list[Entry]:
    """Engine, MuJoCo and PyElastica, each at its cheapest resolution with a tip error
    of at most `most` [m].
    """
    common = ENGINE.limit()
    return [
        _entered(contender, common, most) for contender in (ENGINE, MUJOCO, PYELASTICA)
    ]


def _entered(contender: Contender, common: np.ndarray, most: float) -> Entry:
    """The first choice, in order of parts times steps, that is accurate enough."""
    own = contender.limit()
    for resolution in sorted(contender.choices, key=lambda r: r[0] / r[1]):
        error = tip_error(contender.tip(*resolution), own)
        if error <= most:
            return Entry(contender, resolution, error, tip_error(own, common))
    raise RuntimeError(
        f"{contender.name}: no resolution shows the tip within {most * 1e3:.0f} mm; offer finer ones"
    )
