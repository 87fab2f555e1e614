"""Jobs side by side on this machine."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated

from pydantic import Field

from stringcast.pipeline.sweep.attempt import Attempt
from stringcast.pipeline.sweep.launchers import cores, extra


def launch(
    attempts: Sequence[Attempt], *, workers: Annotated[int, Field(ge=0)], threads: Annotated[int, Field(ge=1)]
) -> Iterator[str]:
    """workers: jobs at a time; 0 is as many as there are cores for. threads: of each job.

    Each worker is a thread that waits for its job's process.
    """
    joblib = extra("joblib", "joblib")
    many = joblib.Parallel(
        workers or max(cores() // threads, 1), backend="threading", return_as="generator_unordered", batch_size=1
    )
    yield from many(joblib.delayed(attempt)(threads) for attempt in attempts)
