"""The terminal: how this program was called, what is printed on it, and messages and
exit statuses of what fails.

Names that others gave are text: an escape sequence in one would steer the terminal.
"""

from __future__ import annotations

import difflib
import re
import shlex
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hydra.core.global_hydra import GlobalHydra
from rich.console import Console
from rich.markup import escape
from rich.segment import Segment

from stringcast.data.errors import escape_control_characters
from stringcast.pipeline.settings.typed_settings import (
    CONF_FOLDER,
    compose_settings,
    setting_names,
)


class Terminal(Console):
    """A console that spells out control characters in all that is shown on it: words,
    tables, bars.
    """

    def render(self, *given: Any, **how: Any) -> Iterator[Segment]:
        """Render as rich does, with control characters in texts spelt out; rich's own
        control codes stay.
        """
        for segment in super().render(*given, **how):
            yield (
                segment
                if segment.is_control
                else Segment(escape_control_characters(segment.text), segment.style)
            )


def program_name() -> str:
    """`stringcast`, or the interpreter with `-m pipeline`, by the shortest path from
    here.
    """
    if Path(sys.argv[0]).stem == "stringcast":
        return "stringcast"
    module = "pipeline" if (Path.cwd() / "pipeline").is_dir() else "stringcast"
    return f"{python_path()} -m {module}"


def python_path() -> Path:
    """The interpreter that runs this, by the shortest path from here."""
    here, python = Path.cwd(), Path(sys.executable)
    return python.relative_to(here) if python.is_relative_to(here) else python


def with_program_name(text: str) -> str:
    """A text with the commands in it as this program was called, and with the pip of
    what runs it.
    """
    text = re.sub(r"(?<![\w/.])python -m pipeline", lambda _: program_name(), text)
    return re.sub(
        r"(?<!-m )pip install", lambda _: f"{python_path()} -m pip install", text
    )


def print_error(error: Exception, console: Terminal) -> None:
    """Print an error's message, with commands as this program was called."""
    console.print(
        f"[bold red]Error:[/] {escape(with_program_name(str(error)))}",
        highlight=False,
        soft_wrap=True,
    )


def interrupt_status(by: KeyboardInterrupt) -> int:
    """Exit status after a signal, as shells have it: 130 after Ctrl-C, 143 after
    SIGTERM, which asks an arm to stop.
    """
    return 128 + int(by.args[0] if by.args else signal.SIGINT)


def explain_hydra_error(error: BaseException) -> str:
    """Hydra's message, with the nearest setting there is."""
    said = str(error).strip().splitlines()[0]
    key = re.match(r"Could not override '([^']+)'", said)
    if beyond := re.match(r"LexerNoViableAltException: (.+=.*)", said):
        # for letters such as those of Jörg
        name, _, value = beyond[1].partition("=")
        again = shlex.join(
            f'{name}="{value}"' if word == beyond[1] else word for word in sys.argv[1:]
        )
        return f"{beyond[1]}: letters beyond ASCII are read between quotes only. Try: python -m pipeline {again}"
    if re.match("no viable|mismatched|missing|extraneous|token recognition", said):
        at = re.search(r"at input '([^']*)'", str(error))
        unread = next(
            (word for word in sys.argv[1:] if at and at[1] in word), "The command line"
        )
        return f"{unread}: it cannot be read. Close brackets and quotes, and quote it: 'effects=[tip_mass]'"
    if several := re.match("Ambiguous value for argument '([^']+)'", said):
        again = shlex.join(["--multirun", *sys.argv[1:]])
        return f"{several[1]}: several values are a sweep, a run of each. Try: python -m pipeline {again}"
    if key is None:
        said = "\n".join(
            line
            for line in str(error).splitlines()
            if line.strip() and "provider" not in line
        )
        return said.removesuffix("Config search path:").strip()
    GlobalHydra.instance().clear()
    groups = [
        word
        for word in sys.argv[1:]
        if (CONF_FOLDER / word.partition("=")[0].lstrip("+")).is_dir()
    ]
    names = list(setting_names(compose_settings(groups)))
    near = difflib.get_close_matches(key[1], names, 1)
    remedy = f"Did you mean '{near[0]}'?" if near else "See python -m pipeline --help."
    # an option of a group may have it that those of this call have not:
    # `estimate=random_search` has `estimate.beta`
    group, _, inner = key[1].partition(".")
    line = re.compile(rf"^{re.escape(inner)}:", re.M)
    files = sorted((CONF_FOLDER / group).glob("*.yaml")) if inner else []
    there = [
        f"{group}={file.stem}"
        for file in files
        if line.search(file.read_text(encoding="utf-8"))
    ]
    remedy = f"It is one of {' and '.join(there)}." if there else remedy
    return f"{key[1]} (command line): there is no such setting. {remedy}"
