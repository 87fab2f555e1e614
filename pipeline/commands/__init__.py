"""What can be asked beside a run itself: `python -m pipeline <command> ...`; each has its own --help.

A command is a module of this folder: its docstring's first line says what it does, `main(arguments)` does it and
returns the exit status: 0 is yes or done, 1 is no, 2 means that it could not be answered.
"""

from __future__ import annotations

import ast
from importlib import import_module
from keyword import iskeyword
from pathlib import Path
from types import ModuleType

NAMES = (
    "import",
    "check",
    "board",
    "draw",
    "resume",
    "index",
    "verify",
    "why",
    "diff",
    "lineage",
    "pictures",
    "export",
)


def command(name: str) -> ModuleType:
    """A command, loaded: some draw, which takes a second to load, and neither a run nor the help needs any."""
    return import_module(f"stringcast.pipeline.commands.{_module(name)}")


def listed() -> str:
    """The commands, a line each, for the help."""
    return "\n".join(f"  {name:<8} {_first_line(name)}" for name in NAMES)


def _module(name: str) -> str:
    """A command's module: Python keeps some names for itself."""
    return f"{name}_" if iskeyword(name) else name


def _first_line(name: str) -> str:
    text = Path(__file__).with_name(f"{_module(name)}.py").read_text(encoding="utf-8")
    return (ast.get_docstring(ast.parse(text)) or "").splitlines()[0]
