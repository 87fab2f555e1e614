"""Step loops compiled for blocks of candidates, and their buffers.

A single candidate leaves all lanes but one idle. The same text with one lane is a
scalar loop, which takes half the time of sixteen lanes. With the paper's forces its
result is the same to the last bit. Its compilation takes as long as a thousand runs
save, so it is compiled after these.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import cache
from itertools import count, repeat
from typing import Any

import numpy as np

from stringcast.stages.model.effect import StringEffect
from stringcast.stages.model.engine.integrators import Integrator
from stringcast.stages.model.engine.kernel_codegen import LANES, generate_source
from stringcast.stages.model.engine.module_cache import (
    import_generated_module,
    module_path,
)
from stringcast.stages.model.engine.threads import parallel_for
from stringcast.stages.model.string import PAPER_EFFECTS

# Runs of one candidate after which a loop of one lane pays: each saves 0.4 to 3 ms, and
# compilation takes 1.5 to 2.6 s.
RUNS_BEFORE_SINGLE_LANE = 1000
PADDING_POINTS = 2  # zero points after the tip, which the loop reads
CACHE_LINE = 64  # bytes

StepLoop = Callable[..., None]
Effects = tuple[type[StringEffect], ...]


@cache
def compile_step_loop(
    effects: Effects,
    row_names: tuple[str, ...],
    integrator: Integrator,
    lanes: int = LANES,
) -> StepLoop:
    """Compile the step loop for these effects.

    Parameters
    ----------
    effects : tuple of StringEffect classes
        The effects whose laws are in the loop.
    row_names : tuple of str
        Names of the rows of parameters, as `String.row_names`.
    integrator : Integrator
        The time step.
    lanes : int
        Number of candidates side by side.

    Returns
    -------
    callable
        `run(buffers, values=, hands=, ...)`, see `step_loop_template.py`, for all
        blocks, on as many threads as Numba is set to use. Buffers are (blocks, points,
        rows, lanes) and values (blocks, parameters, lanes).
    """
    source = generate_source(effects, row_names, integrator, lanes)
    run_blocks = import_generated_module(source).run

    def run(buffers: np.ndarray, values: np.ndarray, **arguments: Any) -> None:
        blocks = len(buffers)
        flat = buffers.reshape(blocks, -1), values.reshape(blocks, -1)
        alive = np.ones((blocks, lanes), dtype=bool)

        def work(first: int, last: int) -> None:
            run_blocks(first, last, *flat, alive=alive, **arguments)

        parallel_for(work, blocks)

    return run


def lane_count(
    candidates: int,
    effects: Effects,
    row_names: tuple[str, ...],
    integrator: Integrator,
) -> int:
    """Choose how many candidates run side by side.

    A single candidate runs in a loop of one lane, once that pays.
    """
    if candidates != 1:
        return LANES
    runs = next(_single_lane_runs(effects, row_names, integrator))
    return 1 if runs >= RUNS_BEFORE_SINGLE_LANE else LANES


@cache
def _single_lane_runs(
    effects: Effects, row_names: tuple[str, ...], integrator: Integrator
) -> Iterator[int]:
    """Count the runs of a single candidate.

    If the loop is in the cache, the count starts at the threshold. With effects beyond
    the paper's forces it never reaches it, because the compiler rounds some of their
    sums differently in one lane.
    """
    if effects != PAPER_EFFECTS:
        return repeat(-1)
    source = generate_source(effects, row_names, integrator, 1)
    return count(RUNS_BEFORE_SINGLE_LANE if module_path(source).exists() else 0)


def aligned_zeros(shape: tuple[int, ...]) -> np.ndarray:
    """Return zeros aligned to a cache line.

    NumPy aligns to 16 bytes only. A vector of 64 bytes that crosses a line is read and
    written twice.
    """
    size = np.dtype(np.float64).itemsize * math.prod(shape)
    memory = np.zeros(size + CACHE_LINE, dtype=np.uint8)
    first = -memory.ctypes.data % CACHE_LINE
    return memory[first : first + size].view(np.float64).reshape(shape)
