"""One job after another on this machine."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated

from pydantic import Field

from stringcast.pipeline.sweep.attempt import Attempt
from stringcast.pipeline.sweep.launchers import cores


def launch(attempts: Sequence[Attempt], *, threads: Annotated[int, Field(ge=0)]) -> Iterator[str]:
    """Run attempts one after another; yields the key of each that has ended. threads: of a job; 0 is all cores."""
    for attempt in attempts:
        yield attempt(threads or cores())
