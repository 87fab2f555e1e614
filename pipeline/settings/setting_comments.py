"""Meaning and unit of settings: the comments of the files in `conf`, by the settings'
full names.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

from stringcast.pipeline.settings.typed_settings import CONF_FOLDER

SETTING_LINE = re.compile(
    r"(?P<indent> *)(?P<name>[\w.]+):(?P<value>[^#]*)(#\s*(?P<comment>.*))?$"
)
# groups whose settings stand under another name
RENAMED_GROUP = re.compile(r"- (\w+)@(\w+):")
CONTINUED_COMMENT = re.compile(r" +#\s*(.*)")  # a comment that goes on in the next line
COMMENT_COLUMN = 40  # at which meanings begin


@cache
def setting_comments() -> dict[str, str]:
    """Comments by name: `estimate.beta`, `seed`. Of options of a group that call a
    setting alike, the first counts.
    """
    found: dict[str, str] = {}
    groups = (
        file
        for file in sorted(CONF_FOLDER.rglob("*/*.yaml"))
        if file.relative_to(CONF_FOLDER).parts[0] != "experiment"
    )
    for file in (CONF_FOLDER / "config.yaml", *groups):
        for name, comment in comments_in_file(file):
            found.setdefault(name, comment)
    for group, name in RENAMED_GROUP.findall(
        (CONF_FOLDER / "config.yaml").read_text(encoding="utf-8")
    ):
        found |= {
            name + inner.removeprefix(group): said
            for inner, said in found.items()
            if inner.startswith(f"{group}.")
        }
    return found


def setting_units(names: Iterable[str]) -> dict[str, str]:
    """Units of these settings, of those that have one."""
    found = {
        name: re.search(r"\[([^\]]+)\]", setting_comments().get(name, ""))
        for name in names
    }
    return {name: unit[1] for name, unit in found.items() if unit and unit[1] != "1"}


def comments_in_file(file: Path) -> Iterator[tuple[str, str]]:
    """Names and comments of a file's settings."""
    text = file.read_text(encoding="utf-8")
    alone = file.parent == CONF_FOLDER or "@package _global_" in text
    name, comment = "", ""
    for line, begun, said in named_lines(
        text, "" if alone else file.parent.relative_to(CONF_FOLDER).as_posix()
    ):
        if begun:
            yield from [(name, comment)] if comment else []
            name, comment = begun, said
        elif comment and (more := CONTINUED_COMMENT.match(line)):
            comment += f" {more[1]}"
    yield from [(name, comment)] if comment else []


def annotate_settings(text: str) -> Iterator[str]:
    """Lines of settings as YAML, each with what it means behind it."""
    for line, name, _ in named_lines(text):
        meaning = setting_comments().get(name, "")
        yield f"{line:<{COMMENT_COLUMN}}# {meaning}" if meaning else line


def named_lines(text: str, block: str = "") -> Iterator[tuple[str, str, str]]:
    """Lines of settings as YAML, each with the full name of the setting that begins
    there, if any, and its comment. block: that they are in.
    """
    above = [(-1, block)] if block else []
    for line in text.splitlines():
        found = SETTING_LINE.match(line)
        if found is None:
            yield line, "", ""
            continue
        indent = len(found["indent"])
        above = [(depth, part) for depth, part in above if depth < indent] + [
            (indent, found["name"])
        ]
        yield line, ".".join(part for _, part in above), found["comment"] or ""
