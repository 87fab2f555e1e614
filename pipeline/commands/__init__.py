"""Commands beside a run itself: `python -m pipeline <command> ...`; each has its own
--help.
"""

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
    """A parser of a command's arguments whose errors are one line, as everywhere."""

    def error(self, message: str) -> NoReturn:
        """Raise UserError with what is wrong and how to see the help."""
        plain = message.removeprefix("the following ").replace(
            "arguments are required", "it needs"
        )
        raise UserError(f"{self.prog.split()[-1]}: {plain}. Try: {self.prog} --help")


def parse_paths(
    command: Callable[[list[str]], int], arguments: list[str], **meanings: str
) -> list[Path]:
    """The paths that a command is given, one for each of `meanings`: the help by the
    name that it shows.
    """
    parser = CommandParser(
        f"python -m pipeline {command.__name__}", description=command.__doc__
    )
    for name, meaning in meanings.items():
        parser.add_argument(name, type=Path, help=meaning)
    return [*vars(parser.parse_args(arguments)).values()]


def load_command(name: str) -> Callable[[list[str]], int]:
    """A command, from the words behind its name to the exit status. It is loaded now:
    some draw, which takes a second to load, and neither a run nor the help needs any.
    """
    module = import_module(f"stringcast.pipeline.commands.{module_name_of(name)}")
    main: Callable[[list[str]], int] = getattr(
        module, name if name in PROVENANCE_COMMANDS else "main"
    )
    return main


def command_list() -> str:
    """The commands, a line each, for the help: the first of a command's description,
    without loading the command.
    """
    lines = []
    for name in COMMAND_NAMES:
        tree = ast.parse(
            Path(__file__)
            .with_name(f"{module_name_of(name)}.py")
            .read_text(encoding="utf-8")
        )
        functions = {
            node.name: node for node in tree.body if isinstance(node, ast.FunctionDef)
        }
        described = (
            ast.get_docstring(functions[name] if name in PROVENANCE_COMMANDS else tree)
            or ""
        )
        lines.append(f"  {name:<8} {described.splitlines()[0]}")
    return "\n".join(lines)


def module_name_of(name: str) -> str:
    """A command's module: Python keeps some names for itself."""
    return (
        "provenance"
        if name in PROVENANCE_COMMANDS
        else f"{name}_"
        if iskeyword(name)
        else name
    )
