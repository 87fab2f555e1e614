"""The engine's step loop by itself: the very call that `simulate` makes, to be made
again and timed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from unittest.mock import patch

import numpy as np

from stringcast.stages.model.engine import batching
from stringcast.stages.model.engine.simulate import simulate
from stringcast.stages.model.engine.stability import steps_per_tick
from stringcast.stages.model.hand import HandMotion
from stringcast.stages.model.string import String


@dataclass(frozen=True)
class StepLoop:
    """A compiled step loop, the state it began from and what else it was called with.
    point_steps: how many mass points it moves one step.
    """

    run: Callable[..., None]
    start: np.ndarray
    arguments: Mapping[str, object]
    point_steps: int

    def __call__(self) -> None:
        """Run it from the initial state."""
        self.run(_copied(self.start), **self.arguments)


def step_loop(
    string: String, hand: HandMotion, values: np.ndarray, times: np.ndarray
) -> StepLoop:
    """The step loop of `simulate` with these arguments; the candidates must share a
    step.
    """
    calls = []
    compiled = batching.compile_step_loop

    def caught(*key: object) -> Callable[..., None]:
        run = compiled(*key)

        def noted(buffers: np.ndarray, **rest: object) -> None:
            calls.append((run, _copied(buffers), rest))
            run(buffers, **rest)

        return noted

    with patch.object(batching, "compile_step_loop", caught):
        simulate(string, hand, values, times)
    ((run, start, arguments),) = calls
    return StepLoop(run, start, arguments, point_steps(string, hand, values, times))


def point_steps(
    string: String, hand: HandMotion, values: np.ndarray, times: np.ndarray
) -> int:
    """Steps of all mass points of all candidates."""
    steps, _ = steps_per_tick(string, string.material(values), hand.tick)
    ticks = int(np.ceil((times[-1] - hand.start) / hand.tick - 1e-9))
    return int(steps.sum()) * ticks * string.points * len(string.integrator.stage_times)


def _copied(buffers: np.ndarray) -> np.ndarray:
    copy = batching.aligned_zeros(buffers.shape)
    copy[:] = buffers
    return copy
