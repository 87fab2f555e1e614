"""How this program was called, so that what is printed can be pasted."""

from __future__ import annotations

import sys
from pathlib import Path


def called_as() -> str:
    """`stringcast`, or the interpreter with `-m pipeline`, by the shortest path from here."""
    if Path(sys.argv[0]).stem == "stringcast":
        return "stringcast"
    here, python = Path.cwd(), Path(sys.executable)
    module = "pipeline" if (here / "pipeline").is_dir() else "stringcast"
    return f"{python.relative_to(here) if python.is_relative_to(here) else python} -m {module}"


def as_called(text: str) -> str:
    """A text with the commands in it as this program was called."""
    return text.replace("python -m pipeline", called_as())
