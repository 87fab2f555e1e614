"""How this program was called, so that what is printed can be pasted."""

from __future__ import annotations

import sys
from pathlib import Path


def called_as() -> str:
    """`stringcast`, or the interpreter with `-m pipeline`, by the shortest path from here."""
    if Path(sys.argv[0]).stem == "stringcast":
        return "stringcast"
    here, python = Path.cwd(), Path(sys.executable)
    return f"{python.relative_to(here) if python.is_relative_to(here) else python} -m pipeline"
