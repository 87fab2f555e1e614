"""Jobs on the machines of a Ray cluster, which all see the sweep's folder, this one and Python under the same paths."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated, Any

from pydantic import Field

from stringcast.pipeline.settings import UserError
from stringcast.pipeline.sweep.attempt import Attempt
from stringcast.pipeline.sweep.launchers import extra


def launch(
    attempts: Sequence[Attempt],
    *,
    address: str | None,
    threads: Annotated[int, Field(ge=1)],
    resources: dict[str, Any],
) -> Iterator[str]:
    """address: of the cluster's head; None begins one on this machine. threads: of a job, and cores it takes.

    resources: what else a job needs, as `ray.remote` takes it, such as {"memory": 2e9}.
    """
    ray = extra("ray", "ray")
    try:
        ray.init(address=address, include_dashboard=False, log_to_driver=False)
    except Exception as error:  # Ray raises nothing more definite
        where = "conf/hydra/launcher/ray.yaml or the command line"
        remedy = "Begin one with ray start --head, or give null to have one begun here"
        raise UserError(f"hydra.launcher.address = {address} ({where}): no Ray answers ({error}). {remedy}.") from error
    try:
        task = ray.remote(num_cpus=threads, **resources)(Attempt.__call__)
        left = {task.remote(attempt, threads): attempt.key for attempt in attempts}
        while left:
            ended, _ = ray.wait(list(left), num_returns=1)
            yield left.pop(ended[0])  # a worker that was lost is seen in the ledger
    finally:
        ray.shutdown()
