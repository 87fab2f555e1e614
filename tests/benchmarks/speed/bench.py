"""Speed of the string engine and of a diagnosis: `python3 tasks.py bench`.

The engine, MuJoCo and PyElastica simulate the same cord at nearly equal tip errors, one
or many at a time, on one core. Models are built and compiled before the clock starts.
Contenders take turns; their ratios within one run count, for machines differ and are
shared. Seconds are processor time.

`bench diagnosis` only diagnoses, which needs no peer: data/sample with the loops to be
compiled and without, and drawn datasets of more trials. To draw those takes minutes.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

import numba
import numpy as np
import pandas as pd
from rich.console import Console
from rich.table import Table

from stringcast.stages.model.engine.accuracy import richardson_limit
from stringcast.stages.model.engine.simulate import simulate
from tests.benchmarks.draw import draw_dataset
from tests.benchmarks.speed.cord import ROOT, TIMES, cord_string, hand_motion

ROUNDS = 5
DRAWN_TRIALS = (10, 25)  # of datasets that are drawn and diagnosed
SINGLE_THREAD = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
MEASURE_PROCESS = """
import os, subprocess, sys
process = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL)
_, status, usage = os.wait4(process.pid, 0)
print(os.waitstatus_to_exitcode(status), usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1e3)
"""  # runs in its own process: a child's peak memory starts with its parent's

Resolution = tuple[int, float]  # points, links or elements; step [s]
Prepare = Callable[[Resolution, int], Callable[[], np.ndarray]]


@dataclass(frozen=True)
class Contender:
    """One way to simulate the cord.

    Attributes
    ----------
    name
        Its name in the table.
    prepare
        Builds a function that simulates so many cords at a resolution. It returns their
        tips (count, F, 2) [m].
    resolutions
        The cheapest resolution with a tip error below 3 mm, and below 1 mm.
    converged
        Two resolutions from which the limit of the tip is extrapolated.
    counts
        How many cords are simulated at a time.
    """

    name: str
    prepare: Prepare
    resolutions: tuple[Resolution, Resolution]
    converged: tuple[Resolution, Resolution]
    counts: tuple[int, ...]

    def tip_error(self, resolution: Resolution) -> float:
        """Return the largest distance of the tip from its limit [m]."""
        coarse, fine, tip = (
            self.prepare(r, 1)()[0] for r in (*self.converged, resolution)
        )
        limit = richardson_limit(coarse, fine)
        return float(np.linalg.norm(tip - limit, axis=-1).max())


def prepare_engine(resolution: Resolution, count: int) -> Callable[[], np.ndarray]:
    """Build the engine's string and compile its step loop."""
    string, values = cord_string(*resolution)
    hand, parameters = hand_motion(), np.tile(values, (count, 1))
    simulate(string, hand, parameters, TIMES[:2])
    return lambda: simulate(string, hand, parameters, TIMES).tip


def prepare_mujoco(resolution: Resolution, count: int) -> Callable[[], np.ndarray]:
    """Build and compile MuJoCo's chain."""
    chain = import_module("tests.benchmarks.speed.mujoco_chain").Chain(*resolution)
    return chain.prepare_rollout(count)


def prepare_pyelastica(resolution: Resolution, count: int) -> Callable[[], np.ndarray]:
    """Assemble PyElastica's rods and compile their kernels."""
    rods = import_module("tests.benchmarks.speed.pyelastica_rod").Rods(*resolution)
    rods.prepare_rollout(count, duration=TIMES[2])()
    return rods.prepare_rollout(count)


ENGINE = Contender(
    "engine (points)",
    prepare_engine,
    resolutions=((24, 2e-3), (40, 2e-3)),
    converged=((25, 5e-5), (49, 5e-5)),
    counts=(1, 16, 256),
)
PEERS = (
    Contender(
        "MuJoCo (links)",
        prepare_mujoco,
        resolutions=((16, 1.25e-3), (26, 1e-3)),
        converged=((20, 2.5e-5), (40, 2.5e-5)),
        counts=(1, 16, 256),
    ),
    Contender(
        "PyElastica (elements)",
        prepare_pyelastica,
        resolutions=((10, 2.5e-4), (18, 1.25e-4)),
        converged=((20, 5e-5), (40, 5e-5)),
        counts=(8,),
    ),
)


def main(arguments: Sequence[str]) -> None:
    """Run the benchmarks and print a line for each result."""
    if list(arguments) not in ([], ["diagnosis"]):
        sys.exit(__doc__)
    if not arguments:
        numba.set_num_threads(1)
        for accuracy in (0, 1):
            Console(width=110).print(simulation_table(accuracy, ROUNDS))
    Console(width=110).print(diagnosis_table())


def simulation_table(accuracy: int, rounds: int) -> Table:
    """Return a table of simulation speeds.

    `accuracy` says which of each contender's resolutions is used.
    """
    seconds = time_contenders((ENGINE, *PEERS), accuracy, rounds)
    title = f"Simulations of {TIMES[-1]} s, tip error below {(3, 1)[accuracy]} mm"
    table = Table(title=f"{title} (median and range of {rounds} rounds, one core)")
    for column in (
        "contender",
        "tip error",
        "at a time",
        "CPU ms each",
        "engine's speed over it",
    ):
        table.add_column(column)
    for contender in (ENGINE, *PEERS):
        parts, step = contender.resolutions[accuracy]
        error = contender.tip_error((parts, step))
        for count in contender.counts:
            each = 1e3 * seconds[contender.name, count] / count
            engine_count = count if count in ENGINE.counts else ENGINE.counts[-1]
            ratio = each / (1e3 * seconds[ENGINE.name, engine_count] / engine_count)
            table.add_row(
                f"{contender.name}: {parts}, {1e3 * step:g} ms",
                f"{1e3 * error:.1f} mm",
                str(count),
                median_and_range(each),
                "" if contender is ENGINE else median_and_range(ratio),
            )
    return table


def time_contenders(
    contenders: Sequence[Contender], accuracy: int, rounds: int
) -> pd.DataFrame:
    """Return processor seconds, with a row for each round.

    A column is a contender and a count.
    """
    rows = []
    for _ in range(rounds):
        row = {}
        for contender in contenders:
            for count in contender.counts:
                run = contender.prepare(contender.resolutions[accuracy], count)
                started = time.process_time()
                run()
                row[contender.name, count] = time.process_time() - started
        rows.append(row)
    return pd.DataFrame(rows)


def median_and_range(values: pd.Series) -> str:
    """Return the median and the range of the rounds in words."""
    return f"{values.median():.3g} ({values.min():.3g} to {values.max():.3g})"


def diagnosis_table() -> Table:
    """Return a table of time, memory and verdict of diagnoses on one thread."""
    table = Table(title="Diagnoses (one core)")
    for column in ("trials", "CPU s", "wall s", "peak MB", "verdict"):
        table.add_column(column)
    sample = str(ROOT / "data" / "sample")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        no_loops = {"STRINGCAST_CACHE": str(folder / "loops")}
        add_diagnosis(table, "data/sample, loops to be compiled", sample, no_loops)
        add_diagnosis(table, "data/sample", sample)
        for trials in DRAWN_TRIALS:
            drawn = folder / f"drawn_{trials}"
            truth = folder / f"drawn_{trials}.json"
            draw_dataset("own_kernel", 3, drawn, truth, "effect", trials)
            add_diagnosis(table, f"{trials} drawn", str(drawn))
    return table


def add_diagnosis(
    table: Table,
    title: str,
    trials: str,
    environment: Mapping[str, str] | None = None,
) -> None:
    """Diagnose a dataset and add a row to the table."""
    with tempfile.TemporaryDirectory() as folder:
        started = time.perf_counter()
        words = (
            "+experiment=diagnose",
            f"trials={trials}",
            f"hydra.run.dir={folder}",
        )
        seconds, megabytes = measure_command(*words, environment=environment)
        wall = time.perf_counter() - started
        document = json.loads(
            (Path(folder) / "diagnosis.json").read_text(encoding="utf-8")
        )
    causes = ", ".join(cause["effect"] for cause in document["causes"])
    verdict = f"{document['verdict']} ({causes})"
    table.add_row(title, f"{seconds:.0f}", f"{wall:.0f}", f"{megabytes:.0f}", verdict)


def measure_command(
    *arguments: str, environment: Mapping[str, str] | None = None
) -> tuple[float, float]:
    """Return processor time [s] and peak memory [MB] of a command on one thread.

    Raises CalledProcessError where it fails.
    """
    command = [sys.executable, "-m", "pipeline", *arguments]
    variables = os.environ | dict.fromkeys(SINGLE_THREAD, "1") | dict(environment or {})
    watched = [sys.executable, "-c", MEASURE_PROCESS, *command]
    done = subprocess.run(
        watched, cwd=ROOT, env=variables, check=True, capture_output=True, text=True
    )
    status, seconds, megabytes = map(float, done.stdout.split())
    if status:
        raise subprocess.CalledProcessError(int(status), command)
    return seconds, megabytes


if __name__ == "__main__":
    main(sys.argv[1:])
