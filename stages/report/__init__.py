"""The report of a run."""

from typing import Any


def report(world: Any, result: Any) -> None:
    """Write the report."""
