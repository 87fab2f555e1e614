"""What can be asked beside a run itself: `python -m pipeline <command> ...`; each has its own --help.

A command is a module of this folder: its docstring's first line says what it does, `main(arguments)` does it and
returns the exit status: 0 is yes or done, 1 is no, 2 means that it could not be answered.
"""

from __future__ import annotations

from types import ModuleType

from pipeline.commands import board, check, diff, draw, index, lineage, pictures, resume, verify, why

COMMANDS: dict[str, ModuleType] = {
    "check": check,
    "board": board,
    "draw": draw,
    "resume": resume,
    "index": index,
    "verify": verify,
    "why": why,
    "diff": diff,
    "lineage": lineage,
    "pictures": pictures,
}


def listed() -> str:
    """The commands, a line each, for the help."""
    return "\n".join(f"  {name:<8} {(module.__doc__ or '').splitlines()[0]}" for name, module in COMMANDS.items())
