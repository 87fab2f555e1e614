"""Commands of `python -m pipeline`, in addition to runs; each explains its options."""

from __future__ import annotations

import argparse
import ast
import re
from collections.abc import Callable, Sequence
from importlib import import_module
from keyword import iskeyword
from pathlib import Path
from typing import NoReturn

from stringcast.pipeline.cli.terminal import Terminal
from stringcast.pipeline.settings.composition import UserError, compose_settings

COMMAND_NAMES = (
    "import",
    "template",
    "check",
    "new",
    "board",
    "graph",
    "resume",
    "index",
    "verify",
    "why",
    "diff",
    "lineage",
    "export",
)

COST_OPTION = "--max-core-hours "


class CommandParser(argparse.ArgumentParser):
    """Argument parser that reports errors in one line."""

    def error(self, message: str) -> NoReturn:
        """Raise UserError with the fault and the help command."""
        plain = message.removeprefix("the following ")
        plain = plain.replace("arguments are required", "it needs")
        command = self.prog.split()[-1]
        option = re.search(r"--[a-z][\w-]*", message)
        field = option[0] if option else ""
        raise UserError(command, plain, f"Try: {self.prog} --help", field)


def add_cost_option(parser: CommandParser) -> None:
    """Add the cost limit above which a person is asked first."""
    parser.add_argument(
        COST_OPTION.strip(),
        type=float,
        default=compose_settings()["max_core_hours"],
        metavar="HOURS",
        help="cost of a step above which you are asked first (default: %(default)s)",
    )


def load_command(name: str) -> Callable[[list[str]], int]:
    """Import the main function of a command.

    Some commands take a second to import; runs and the help need none.
    """
    return import_module(f"{__name__}.{module_name_of(name)}").main


def command_list() -> str:
    """Return a line of help for each command, without importing any."""
    lines = []
    for name in COMMAND_NAMES:
        source = Path(__file__).with_name(f"{module_name_of(name)}.py")
        tree = ast.parse(source.read_text(encoding="utf-8"))
        description = ast.get_docstring(tree) or ""
        lines.append(f"  {name:<8} {description.splitlines()[0]}")
    return "\n".join(lines)


def module_name_of(name: str) -> str:
    """Return the module name of a command, avoiding Python keywords."""
    return f"{name}_" if iskeyword(name) else name


def print_block(heading: str, lines: Sequence[str]) -> None:
    """Print indented lines under a heading."""
    Terminal().print_line("\n    ".join([heading, *lines]))
