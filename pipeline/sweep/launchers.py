"""Run the jobs of a sweep: a function for each value of `hydra/launcher=`.

A launcher is a generator function of attempts, which are callable with a number of
threads and can be pickled. It yields the key of each ended attempt; the ledger holds
the outcome. The settings are in `conf/hydra/launcher`.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Iterator, Sequence
from types import ModuleType
from typing import Any, Literal

from pydantic import NonNegativeInt, PositiveInt

from stringcast.pipeline.settings.composition import UserError
from stringcast.pipeline.sweep.attempt import Attempt

ThreadCount = PositiveInt


def serial(attempts: Sequence[Attempt], *, threads: NonNegativeInt) -> Iterator[str]:
    """Run jobs one after another on this machine; 0 threads: all cores."""
    for attempt in attempts:
        yield attempt(threads or usable_cores())


def joblib(
    attempts: Sequence[Attempt],
    *,
    workers: NonNegativeInt,
    threads: ThreadCount,
) -> Iterator[str]:
    """Run jobs in parallel on this machine, in threads that wait for processes.

    0 workers: as many as the cores allow.
    """
    package = import_package("joblib", "joblib")
    run_parallel = package.Parallel(
        workers or max(usable_cores() // threads, 1),
        backend="threading",
        return_as="generator_unordered",
        batch_size=1,
    )
    yield from run_parallel(package.delayed(attempt)(threads) for attempt in attempts)


def ray(
    attempts: Sequence[Attempt],
    *,
    address: str | None,
    threads: ThreadCount,
    resources: dict[str, Any],
) -> Iterator[str]:
    """Run jobs on a Ray cluster, whose machines share all folders and Python.

    `resources` are further ones of a job for `ray.remote`, such as {"memory": 2e9}.
    """
    package = import_package("ray", "ray")
    try:
        package.init(address=address, include_dashboard=False, log_to_driver=False)
    except Exception as error:  # Ray raises no specific type
        where = "conf/hydra/launcher/ray.yaml or the command line"
        setting = f"hydra.launcher.address = {address} ({where})"
        remedy = "Start one with ray start --head, or give null to start one here."
        raise UserError(setting, f"no Ray answers ({error})", remedy) from error
    try:
        task = package.remote(num_cpus=threads, **resources)(Attempt.__call__)
        keys = {task.remote(attempt, threads): attempt.key for attempt in attempts}
        while keys:
            ended, _ = package.wait(list(keys), num_returns=1)
            yield keys.pop(ended[0])  # the ledger shows lost workers
    finally:
        package.shutdown()


def slurm(
    attempts: Sequence[Attempt],
    *,
    cluster: Literal["slurm", "local"],
    threads: ThreadCount,
    parameters: dict[str, Any],
) -> Iterator[str]:
    """Run jobs in the queue of a Slurm cluster, whose machines share all folders.

    `parameters` are those of the queue for submitit, such as `timeout_min`.
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
    """Return the number of cores that this process may use, if the system knows."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def import_package(package: str, launcher: str) -> ModuleType:
    """Import an optional package, or raise UserError with the install command."""
    try:
        return importlib.import_module(package)
    except ImportError as error:
        fault = f"the package {package} is missing ({error})"
        remedy = f"Install it with pip install {package}."
        raise UserError(f"hydra/launcher={launcher}", fault, remedy) from error
