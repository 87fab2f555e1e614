"""How this program was called, so that what is printed can be pasted."""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from stringcast.pipeline.settings import CONF


def called_as() -> str:
    """`stringcast`, or the interpreter with `-m pipeline`, by the shortest path from here."""
    if Path(sys.argv[0]).stem == "stringcast":
        return "stringcast"
    here, python = Path.cwd(), Path(sys.executable)
    module = "pipeline" if (here / "pipeline").is_dir() else "stringcast"
    return f"{python.relative_to(here) if python.is_relative_to(here) else python} -m {module}"


def as_called(text: str) -> str:
    """A text with the commands in it as this program was called."""
    return re.sub(r"(?<![\w/.])python -m pipeline", lambda _: called_as(), text)


def by_the_other_method(config: Mapping[str, Any]) -> str:
    """The arguments of a run by the other method; empty where a run is none of the paper's."""
    other, name = config.get("other_method"), config["name"]
    if not other or not (CONF / "experiment" / f"{name}.yaml").exists() or name == "robust":
        return ""
    return f"+experiment={name} method={other}"
