"""Commands beside a run itself: `python -m pipeline <command>`, each with --help."""

from __future__ import annotations

import argparse
import ast
from collections.abc import Callable
from importlib import import_module
from keyword import iskeyword
from pathlib import Path
from typing import NoReturn

from stringcast.pipeline.settings.composition import UserError

COMMAND_NAMES = (
    "import",
    "template",
    "check",
    "new",
    "board",
    "resume",
    "index",
    "verify",
    "why",
    "diff",
    "lineage",
    "export",
)
PROVENANCE_COMMANDS = frozenset({"verify", "why", "diff", "lineage"})


class CommandParser(argparse.ArgumentParser):
    """Parser of a command's arguments that reports errors in one line."""

    def error(self, message: str) -> NoReturn:
        """Raise UserError with what is wrong and how to see the help."""
        plain = message.removeprefix("the following ")
        plain = plain.replace("arguments are required", "it needs")
        command = self.prog.split()[-1]
        raise UserError(f"{command}: {plain}. Try: {self.prog} --help")


def parse_paths(
    command: Callable[[list[str]], int], arguments: list[str], **meanings: str
) -> list[Path]:
    """Return the paths that a command is given.

    `meanings` holds the help for each path, by the name that the help shows.
    """
    program = f"python -m pipeline {command.__name__}"
    parser = CommandParser(program, description=command.__doc__)
    for name, meaning in meanings.items():
        parser.add_argument(name, type=Path, help=meaning)
    return list(vars(parser.parse_args(arguments)).values())


def load_command(name: str) -> Callable[[list[str]], int]:
    """Import a command, which takes the words after its name and returns the status.

    Some commands draw and take a second to import; runs and the help need none.
    """
    module = import_module(f"{__name__}.{module_name_of(name)}")
    function = name if name in PROVENANCE_COMMANDS else "main"
    command: Callable[[list[str]], int] = getattr(module, function)
    return command


def command_list() -> str:
    """Return a line of help for each command, without importing any."""
    folder = Path(__file__).parent
    lines = []
    for name in COMMAND_NAMES:
        source = folder / f"{module_name_of(name)}.py"
        tree = ast.parse(source.read_text(encoding="utf-8"))
        described: ast.Module | ast.FunctionDef = tree
        for node in tree.body:
            if isinstance(node, ast.FunctionDef) and node.name == name:
                described = node
        description = ast.get_docstring(described) or ""
        lines.append(f"  {name:<8} {description.splitlines()[0]}")
    return "\n".join(lines)


def module_name_of(name: str) -> str:
    """Return the name of a command's module, which must not be a Python keyword."""
    if name in PROVENANCE_COMMANDS:
        return "provenance"
    return f"{name}_" if iskeyword(name) else name
