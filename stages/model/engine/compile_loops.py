"""Compile the loops of all effects of the library, so that first runs do not wait.

Usage: `python -m stringcast.stages.model.engine.compile_loops`. Loops in the cache are
not compiled again.
"""

from __future__ import annotations

import multiprocessing
from concurrent.futures import ProcessPoolExecutor

import numpy as np

from stringcast.stages.model.effect import StringEffect
from stringcast.stages.model.engine.implicit_leapfrog import ImplicitLeapfrog
from stringcast.stages.model.engine.integrators import Integrator, SemiImplicitEuler
from stringcast.stages.model.engine.simulate import simulate
from stringcast.stages.model.hand import resample_hand_motion
from stringcast.stages.model.state import StringState
from stringcast.stages.model.string import (
    COSTLY_EFFECTS,
    JOINTLY_COMPILED_EFFECTS,
    PAPER_EFFECTS,
    String,
)

# The integrator of each loop, and effects that only this loop contains.
LOOPS: tuple[tuple[Integrator, tuple[type[StringEffect], ...]], ...] = (
    (ImplicitLeapfrog(), ()),
    (ImplicitLeapfrog(), JOINTLY_COMPILED_EFFECTS[:1]),
    (ImplicitLeapfrog(), COSTLY_EFFECTS[:1]),
    (SemiImplicitEuler(), ()),
)


def main() -> None:
    """Compile all loops, each in a process of its own."""
    # The first loop also compiles the functions that all loops use.
    first, *others = LOOPS
    run_loop(*first)
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(mp_context=spawn) as executor:
        compiling = [executor.submit(run_loop, *loop) for loop in others]
        for loop in compiling:
            loop.result()


def run_loop(integrator: Integrator, effects: tuple[type[StringEffect], ...]) -> None:
    """Simulate a short string with some effects, from rest and from a state."""
    string = String(0.3, effects=(*PAPER_EFFECTS, *effects), integrator=integrator)
    ticks = 5e-3 * np.arange(3)
    hand = resample_hand_motion(ticks, np.zeros((3, 3)) - [0, 0, np.pi / 2])
    values = np.repeat(string.start_values()[None], 2, axis=0)
    times = np.repeat(ticks[None], 2, axis=0)
    s = np.linspace(0.0, string.length, 5)
    state = StringState(0.0, s, np.full(5, -np.pi / 2), np.zeros(5))
    simulate(string, hand, values, ticks)
    simulate(string, hand, values, times, state)


if __name__ == "__main__":
    main()
