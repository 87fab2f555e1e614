"""How far a stage is: a function that is told the share of it that is done."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[float], object]


def part(progress: Progress, number: int, count: int) -> Progress:
    """The progress of one of so many parts that take as long as each other."""
    return lambda share: progress((number + share) / count)
