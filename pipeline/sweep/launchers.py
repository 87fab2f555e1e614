"""Who runs the jobs of a sweep, a function each, chosen by `hydra/launcher=`; their
settings are in `conf/hydra/launcher`.

A launcher is a generator function: from attempts, which can be pickled and are called
with a number of threads, it yields the key of each when it has ended. What became of it
stands in the ledger.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Iterator, Sequence
from types import ModuleType
from typing import Annotated, Any, Literal

from pydantic import Field

from stringcast.pipeline.settings.composition import UserError
from stringcast.pipeline.sweep.attempt import Attempt

ThreadCount = Annotated[int, Field(ge=1)]


def serial(
    attempts: Sequence[Attempt], *, threads: Annotated[int, Field(ge=0)]
) -> Iterator[str]:
    """One job after another on this machine. threads: of a job; 0 is all cores."""
    for attempt in attempts:
        yield attempt(threads or usable_cores())


def joblib(
    attempts: Sequence[Attempt],
    *,
    workers: Annotated[int, Field(ge=0)],
    threads: ThreadCount,
) -> Iterator[str]:
    """Jobs side by side on this machine. workers: jobs at a time; 0 is as many as there
    are cores for. threads: of each job.

    Each worker is a thread that waits for its job's process.
    """
    package = import_package("joblib", "joblib")
    many = package.Parallel(
        workers or max(usable_cores() // threads, 1),
        backend="threading",
        return_as="generator_unordered",
        batch_size=1,
    )
    yield from many(package.delayed(attempt)(threads) for attempt in attempts)


def ray(
    attempts: Sequence[Attempt],
    *,
    address: str | None,
    threads: ThreadCount,
    resources: dict[str, Any],
) -> Iterator[str]:
    """Jobs on the machines of a Ray cluster, which all see the sweep's folder, this one
    and Python by the same paths.

    address: of the cluster's head; None begins one on this machine. threads: of a job,
    and cores it takes. resources: what else a job needs, as `ray.remote` takes it, such
    as {"memory": 2e9}.
    """
    package = import_package("ray", "ray")
    try:
        package.init(address=address, include_dashboard=False, log_to_driver=False)
    except Exception as error:  # Ray raises nothing more definite
        where = "conf/hydra/launcher/ray.yaml or the command line"
        remedy = "Begin one with ray start --head, or give null to have one begun here"
        raise UserError(
            f"hydra.launcher.address = {address} ({where}): no Ray answers ({error}). {remedy}."
        ) from error
    try:
        task = package.remote(num_cpus=threads, **resources)(Attempt.__call__)
        left = {task.remote(attempt, threads): attempt.key for attempt in attempts}
        while left:
            ended, _ = package.wait(list(left), num_returns=1)
            yield left.pop(ended[0])  # a worker that was lost is seen in the ledger
    finally:
        package.shutdown()


def slurm(
    attempts: Sequence[Attempt],
    *,
    cluster: Literal["slurm", "local"],
    threads: ThreadCount,
    parameters: dict[str, Any],
) -> Iterator[str]:
    """Jobs in the queue of a Slurm cluster, by submitit; its machines see the sweep's
    folder and this one.

    cluster: local is this machine, without a queue. threads: of a job, and cores it
    asks for. parameters: of the queue, as submitit takes them: timeout_min, mem_gb,
    slurm_partition, ...
    """
    package = import_package("submitit", "slurm")
    executor = package.AutoExecutor(
        folder=attempts[0].folder / "ledger" / "slurm", cluster=cluster
    )
    executor.update_parameters(cpus_per_task=threads, **parameters)
    jobs = executor.map_array(Attempt.__call__, attempts, [threads] * len(attempts))
    keys = {
        job.job_id: attempt.key for job, attempt in zip(jobs, attempts, strict=True)
    }
    for job in package.helpers.as_completed(jobs, poll_frequency=2):
        yield keys[job.job_id]


def usable_cores() -> int:
    """The number of cores that this process may use, where the system tells, else of
    all.
    """
    return (
        len(os.sched_getaffinity(0))
        if hasattr(os, "sched_getaffinity")
        else os.cpu_count() or 1
    )


def import_package(package: str, launcher: str) -> ModuleType:
    """The package; raises UserError saying how to get it."""
    try:
        return importlib.import_module(package)
    except ImportError as error:
        remedy = f"Install it with pip install {package}"
        raise UserError(
            f"hydra/launcher={launcher}: the package {package} is missing ({error}). {remedy}."
        ) from error
