"""Draw benches, have them diagnosed, open the envelopes: a row a bench, each kept on disk as soon as it is there."""

from __future__ import annotations

import json
import multiprocessing
import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any, Protocol

from stringcast.data.store import write_text
from stringcast.hardware.virtual.blind import LATEST
from stringcast.pipeline.origin import state
from stringcast.stages.common import Progress

Row = dict[str, Any]


class Bench(Protocol):
    """A bench with an envelope; see `hardware.virtual.blind`."""

    def write(self, folder: Path) -> None:
        """Write what was measured."""

    def envelope(self, path: Path) -> None:
        """Write what is really so."""


Draw = Callable[[int], Bench]
Diagnose = Callable[[Path], Mapping[str, Any]]
FAILED = "failed"
ONE_THREAD = {"NUMBA_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}


def study(
    seeds: Sequence[int],
    folder: Path,
    draw: Draw,
    diagnose: Diagnose,
    *,
    processes: int,
    progress: Progress = lambda share: None,
) -> list[Row]:
    """One row for each seed, in their order, whatever the number of processes.

    draw, diagnose: functions that can be pickled; see `one_bench`. Rows that are in `folder` already are read.
    """
    with workers(processes) as pool:
        made = {pool.submit(one_bench, seed, folder, draw, diagnose): seed for seed in seeds}
        rows: dict[int, Row] = {}
        for future in as_completed(made):
            rows[made[future]] = future.result()
            progress(len(rows) / len(seeds))
    return [rows[seed] for seed in seeds]


def one_bench(seed: int, folder: Path, draw: Draw, diagnose: Diagnose) -> Row:
    """What was hidden on the bench of a seed and what the diagnosis said, read from `folder` if it is there.

    draw: the bench of a seed. diagnose: from the dataset's folder to what `diagnosis.json` says; if it raises, the
    verdict is FAILED. The envelope is opened afterwards.
    """
    path = folder / "rows" / f"{seed:05d}.json"
    if path.exists():
        row: Row = json.loads(path.read_text(encoding="utf-8"))
        return row
    dataset, envelope = folder / "datasets" / f"{seed:05d}", folder / "envelopes" / f"{seed:05d}.json"
    bench = draw(seed)
    bench.write(dataset)
    bench.envelope(envelope)
    begun = time.perf_counter()
    diagnosis = _diagnosed(diagnose, dataset)
    row = {"seed": seed, "runtime": time.perf_counter() - begun, "diagnosis": diagnosis}
    row |= {"truth": json.loads(envelope.read_text(encoding="utf-8")), "version": LATEST, "code": state()}
    write_text(path, json.dumps(row))
    return row


def _diagnosed(diagnose: Diagnose, dataset: Path) -> Mapping[str, Any]:
    """What it says, or why it failed: one bench must not stop the others, and counts as wrong."""
    try:
        return diagnose(dataset)
    except Exception as error:
        return {"verdict": FAILED, "error": f"{type(error).__name__}: {error}"}


@contextmanager
def workers(processes: int, lives: int | None = None) -> Iterator[ProcessPoolExecutor]:
    """Processes of one thread each, that end with this one; 0 is one for each core. lives: calls after which a process
    is replaced by a new one."""
    context = multiprocessing.get_context("spawn")  # threads of numba do not live through a fork
    count = processes or os.cpu_count() or 1
    pool = ProcessPoolExecutor(count, context, end_with_parent, max_tasks_per_child=lives)
    with _environment(ONE_THREAD), pool:
        yield pool


def end_with_parent() -> None:
    """Have this process end when its parent does, however that was killed; it would go on for hours."""
    threading.Thread(target=_follow, daemon=True).start()


def _follow() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


@contextmanager
def _environment(variables: Mapping[str, str]) -> Iterator[None]:
    """Environment variables for the processes that are begun meanwhile."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})
