"""Step loops compiled for blocks of candidates, and their buffers.

Few candidates leave most of sixteen lanes idle. The same text with eight lanes takes
half the time, with one lane a quarter, and the result is the same to the last bit. Its
compilation takes as long as a thousand runs save, so it is compiled after these.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import cache
from itertools import count
from typing import Any

import llvmlite.binding
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

NARROW_LANES = 8  # of the loop for few candidates
# Runs after which a loop of fewer lanes pays: each saves 1 to 5 ms, and compilation
# takes 1.5 to 5 s.
RUNS_BEFORE_NARROW_LOOP = 1000
PADDING_POINTS = 2  # zero points after the tip, which the loop reads
CACHE_LINE = 64  # bytes

# LLVM does not vectorise a loop of fewer than 16 passes that needs checks whether
# arrays overlap. Without this, eight lanes take longer than sixteen.
llvmlite.binding.set_option("", f"-vectorizer-min-trip-count={NARROW_LANES}")

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

    Few candidates run in a loop of fewer lanes, once that pays.
    """
    lanes = _least_lanes(candidates, effects)
    if lanes == LANES:
        return LANES
    runs = next(_narrow_runs(effects, row_names, integrator, lanes))
    return lanes if runs >= RUNS_BEFORE_NARROW_LOOP else LANES


def _least_lanes(candidates: int, effects: Effects) -> int:
    """Find the loop with the fewest idle lanes.

    Only the paper's forces run in a single lane: the compiler rounds some sums of other
    effects differently there. Full blocks run in the widest loop, which takes less time
    for each candidate.
    """
    if candidates == 1 and effects == PAPER_EFFECTS:
        return 1
    narrow_blocks = math.ceil(candidates / NARROW_LANES)
    return NARROW_LANES if narrow_blocks in (1, 3) else LANES


@cache
def _narrow_runs(
    effects: Effects,
    row_names: tuple[str, ...],
    integrator: Integrator,
    lanes: int,
) -> Iterator[int]:
    """Count the runs for which a loop of fewer lanes suffices.

    If the loop is in the cache, the count starts at the threshold.
    """
    source = generate_source(effects, row_names, integrator, lanes)
    return count(RUNS_BEFORE_NARROW_LOOP if module_path(source).exists() else 0)


def aligned_zeros(shape: tuple[int, ...]) -> np.ndarray:
    """Return zeros aligned to a cache line.

    NumPy aligns to 16 bytes only. A vector of 64 bytes that crosses a line is read and
    written twice.
    """
    size = np.dtype(np.float64).itemsize * math.prod(shape)
    memory = np.zeros(size + CACHE_LINE, dtype=np.uint8)
    first = -memory.ctypes.data % CACHE_LINE
    return memory[first : first + size].view(np.float64).reshape(shape)
