"""The terminal: program name in messages, error explanations and statuses.

Control characters in foreign names are escaped, as they act on the terminal.
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
from rich.text import Text

from stringcast.data.errors import escape_control_characters
from stringcast.pipeline.settings.composition import (
    compose_settings,
    group_files,
    setting_names,
)


class Terminal(Console):
    """A console that escapes control characters in everything it shows."""

    def render(self, *given: Any, **options: Any) -> Iterator[Segment]:
        """Render like rich, with control characters in texts escaped."""
        for segment in super().render(*given, **options):
            if segment.is_control:  # keep rich's own codes
                yield segment
            else:
                yield Segment(escape_control_characters(segment.text), segment.style)

    def print_line(self, text: str) -> None:
        """Print plain text without wrapping, so that it can be pasted."""
        self.print(Text(escape_control_characters(text)), soft_wrap=True)


def program_name() -> str:
    """Return the program call: `stringcast`, or Python with `-m pipeline`."""
    if Path(sys.argv[0]).stem == "stringcast":
        return "stringcast"
    module = "pipeline" if (Path.cwd() / "pipeline").is_dir() else "stringcast"
    return f"{python_path()} -m {module}"


def python_path() -> Path:
    """Return the shortest path to the running interpreter."""
    python, here = Path(sys.executable), Path.cwd()
    return python.relative_to(here) if python.is_relative_to(here) else python


def with_program_name(text: str) -> str:
    """Return a text whose commands start as this program was called."""
    text = re.sub(r"(?<![\w/.])python -m pipeline", lambda _: program_name(), text)
    return re.sub(
        r"(?<!-m )pip install", lambda _: f"{python_path()} -m pip install", text
    )


def print_error(error: Exception, console: Terminal) -> None:
    """Print an error's message, with the actual program call in commands."""
    message = escape(with_program_name(str(error)))
    console.print(f"[bold red]Error:[/] {message}", highlight=False, soft_wrap=True)


def interrupt_status(error: KeyboardInterrupt) -> int:
    """Return a shell's exit status after a signal: 130 for Ctrl-C, 143 for SIGTERM."""
    number = error.args[0] if error.args else signal.SIGINT
    return 128 + int(number)


def explain_hydra_error(error: BaseException) -> str:
    """Return Hydra's message in plain words, with the nearest known setting."""
    text = str(error).strip()
    first_line = text.splitlines()[0]
    arguments = sys.argv[1:]

    if unquoted := re.match(r"LexerNoViableAltException: (.+=.*)", first_line):
        return explain_missing_quotes(unquoted[1], arguments)

    unreadable_line = "no viable|mismatched|missing|extraneous|token recognition"
    if re.match(unreadable_line, first_line):
        place = re.search(r"at input '([^']*)'", text)
        unreadable = "The command line"
        if place:
            containing = (word for word in arguments if place[1] in word)
            unreadable = next(containing, unreadable)
        remedy = "Close brackets and quotes, and quote it: 'effects=[tip_mass]'"
        return f"{unreadable}: it cannot be read. {remedy}"

    if several := re.match("Ambiguous value for argument '([^']+)'", first_line):
        sweep = shlex.join(["--multirun", *arguments])
        return (
            f"{several[1]}: several values make a sweep, with a run for each. "
            f"Try: python -m pipeline {sweep}"
        )

    if unknown := re.match(r"Could not override '([^']+)'", first_line):
        remedy = unknown_setting_remedy(unknown[1])
        return f"{unknown[1]} (command line): there is no such setting. {remedy}"

    lines = [
        line for line in text.splitlines() if line.strip() and "provider" not in line
    ]
    return "\n".join(lines).removesuffix("Config search path:").strip()


def explain_missing_quotes(word: str, arguments: list[str]) -> str:
    """Explain that a word such as name=Jörg or plugins=[~/x] needs quotes."""
    name, _, value = word.partition("=")
    quoted = f'"{value}"'
    if value.startswith("[") and value.endswith("]"):
        values = [f'"{part.strip()}"' for part in value[1:-1].split(",")]
        quoted = f"[{','.join(values)}]"
    corrected = [f"{name}={quoted}" if text == word else text for text in arguments]
    remedy = f"Try: python -m pipeline {shlex.join(corrected)}"
    return f"{word}: signs such as ~ and letters beyond ASCII need quotes. {remedy}"


def unknown_setting_remedy(name: str) -> str:
    """Name the options with this setting, or else a similar setting."""
    # another option of the group may have it, as `estimate=random_search` has `beta`
    group, _, inner_name = name.partition(".")
    line = re.compile(rf"^{re.escape(inner_name)}:", re.M)
    options = []
    for file in group_files(group):
        if inner_name and line.search(file.read_text(encoding="utf-8")):
            options.append(f"{group}={file.stem}")
    if options:
        return f"It belongs to {' and '.join(options)}."

    GlobalHydra.instance().clear()
    chosen_groups = [
        word for word in sys.argv[1:] if group_files(word.partition("=")[0].lstrip("+"))
    ]
    names = list(setting_names(compose_settings(chosen_groups)))
    near = difflib.get_close_matches(name, names, 1)
    return f"Did you mean '{near[0]}'?" if near else "See python -m pipeline --help."
