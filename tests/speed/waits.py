"""What the user waits for: commands as whole processes, one simulation, and two threads
among busy neighbours.

Processes are timed in their own processor time, all threads together, which a neighbour
on the core hardly touches.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numba
import numpy as np
import pandas as pd

from stringcast.known import experiment_for_call
from stringcast.pipeline.sweep.attempt import THREAD_VARIABLES
from stringcast.stages.model.engine import batching
from stringcast.stages.model.engine.simulate import simulate
from stringcast.stages.model.hand import resample_hand_motion
from tests.speed.measures import Row, on_threads, seen
from tests.speed.stopwatch import in_turns
from tests.speed.trial import ROOT, TIMES, B, hand, pose, string_b

QUESTIONS = {"--help": 0.6, "check data/sample": 1.3, "index": 1.3}  # goals [s]
RUN, RUN_GOAL, MEMORY_GOAL = "+experiment=stringB", 30.0, 500.0  # [s], [MB]
ASKED, RUNS = 5, 3  # rounds
SHORT = np.arange(121) * 0.005  # [s]: frames of a trial of 0.6 s
AMONG = 25  # rounds among neighbours, who make each another


def waits() -> list[Row]:
    """All of it."""
    numba.set_num_threads(1)
    return [*questions(), *run(), *one(), *among_neighbours()]


WATCH = """
import os, subprocess, sys
process = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
_, status, usage = os.wait4(process.pid, 0)
print(os.waitstatus_to_exitcode(status), usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1e3)
"""  # in a process of its own: a child's peak begins with what its parent holds when it starts it


def spent(*arguments: str) -> tuple[float, float]:
    """Processor time [s] and peak memory [MB] of the pipeline on one thread. Raises
    where it does not end with 0.
    """
    command = [sys.executable, "-m", "pipeline", *arguments]
    around = os.environ | dict.fromkeys(THREAD_VARIABLES, "1")
    watched = [sys.executable, "-c", WATCH, *command]
    told = subprocess.run(
        watched, cwd=ROOT, env=around, check=True, capture_output=True, text=True
    ).stdout
    status, seconds, megabytes = map(float, told.split())
    if status:
        raise subprocess.CalledProcessError(int(status), command)
    return seconds, megabytes


def questions() -> list[Row]:
    """Commands that only look; `index` at a folder without runs."""
    with TemporaryDirectory() as nothing:
        asked = {
            name: [*name.split(), *([nothing] if name == "index" else [])]
            for name in QUESTIONS
        }
        each = [
            {name: spent(*words)[0] for name, words in asked.items()}
            for _ in range(ASKED)
        ]
    times = pd.DataFrame(each)
    return [
        seen(
            "processor time of a command",
            name,
            times[name],
            "s",
            threads=1,
            at_most=goal,
        )
        for name, goal in QUESTIONS.items()
    ]


def run() -> list[Row]:
    """A whole experiment with its report; the first, which may compile, does not count."""
    with TemporaryDirectory() as aside:
        each = [
            spent(RUN, f"hydra.run.dir={Path(aside) / str(number)}")
            for number in range(1 + RUNS)
        ]
    seconds, memory = (pd.Series(column) for column in zip(*each[1:], strict=True))
    return [
        seen(
            "processor time of a command",
            RUN,
            seconds,
            "s",
            threads=1,
            at_most=RUN_GOAL,
        ),
        seen("peak memory of a run", RUN, memory, "MB", threads=1, at_most=MEMORY_GOAL),
    ]


def one() -> list[Row]:
    """One simulation of 0.6 s, of the paper's string and of the default one, from a
    hand that bends them at rest; after as many as have the loop for one candidate
    compiled.
    """
    bent = resample_hand_motion(TIMES, pose(TIMES) + [0.0, 0.0, 1.0])
    rows = []
    for words, goal in (("string=paper", 1.0), ("string=fine", None)):
        string = experiment_for_call((words,), None).string
        call = partial(simulate, string, bent, string.values(B)[None], SHORT)
        for _ in range(batching.RUNS_BEFORE_SINGLE_LANE):
            call()
        each = in_turns({"one": call}, 99)["one"] * 1e3
        how = {"points": string.points, "threads": 1, "batch": 1} | (
            {"at_most": goal} if goal else {}
        )
        rows.append(
            seen(
                "one simulation of 0.6 s",
                f"engine, simulate, {words}",
                each,
                "ms",
                **how,
            )
        )
    return rows


def among_neighbours() -> list[Row]:
    """Time on two threads over that on one, by the wall clock, while others keep every
    core busy twice over.
    """
    string, values = string_b(10)
    rows = []
    for batch in (32, 256):
        call = partial(simulate, string, hand(), np.tile(values, (batch, 1)), SHORT)
        with _neighbours(2 * (os.cpu_count() or 1)):
            wall = in_turns(
                {count: partial(on_threads, count, call) for count in (1, 2)},
                AMONG,
                time.perf_counter,
            )
        measure, more = (
            "two threads over one, busy machine",
            {"points": 10, "threads": 2, "batch": batch},
        )
        rows.append(
            seen(measure, "engine, simulate", wall[2] / wall[1], "1", **more, at_most=1)
        )
    return rows


@contextmanager
def _neighbours(count: int) -> Iterator[None]:
    """So many processes that do nothing else than take time."""
    others = [
        subprocess.Popen([sys.executable, "-c", "while True: pass"])
        for _ in range(count)
    ]
    try:
        yield
    finally:
        for other in others:
            other.kill()
            other.wait()
