"""The terminal, on which names that others gave are text: an escape sequence in one would steer it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rich.console import Console
from rich.segment import Segment

from stringcast.data.errors import printable


class Terminal(Console):
    """A console that spells out control characters in all that is shown on it: words, tables, bars."""

    def render(self, *given: Any, **how: Any) -> Iterator[Segment]:
        """Render as rich does, with control characters in texts spelt out; rich's own control codes stay."""
        for segment in super().render(*given, **how):
            yield segment if segment.is_control else Segment(printable(segment.text), segment.style)
