"""Jobs in the queue of a Slurm cluster, by submitit; its machines see the sweep's folder and this one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated, Any, Literal

from pydantic import Field

from stringcast.pipeline.sweep.attempt import Attempt
from stringcast.pipeline.sweep.launchers import extra


def launch(
    attempts: Sequence[Attempt],
    *,
    cluster: Literal["slurm", "local"],
    threads: Annotated[int, Field(ge=1)],
    parameters: dict[str, Any],
) -> Iterator[str]:
    """cluster: local is this machine, without a queue. threads: of a job, and cores it asks for.

    parameters: of the queue, as submitit takes them: timeout_min, mem_gb, slurm_partition, ...
    """
    submitit = extra("submitit", "slurm")
    executor = submitit.AutoExecutor(folder=attempts[0].folder / "ledger" / "slurm", cluster=cluster)
    executor.update_parameters(cpus_per_task=threads, **parameters)
    jobs = executor.map_array(Attempt.__call__, attempts, [threads] * len(attempts))
    keys = {job.job_id: attempt.key for job, attempt in zip(jobs, attempts, strict=True)}
    for job in submitit.helpers.as_completed(jobs, poll_frequency=2):
        yield keys[job.job_id]
