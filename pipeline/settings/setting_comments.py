"""Meanings and units of settings, from the comments in the files of `conf`."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

from stringcast.pipeline.settings.composition import CONF_FOLDER, conf_folders

SETTING_LINE = re.compile(
    r"(?P<indent> *)(?P<name>[\w.]+):(?P<value>[^#]*)(#\s*(?P<comment>.*))?$"
)
# groups whose settings have another name
RENAMED_GROUP = re.compile(r"- (\w+)@(\w+):")
CONTINUED_COMMENT = re.compile(r" +#\s*(.*)")
COMMENT_COLUMN = 40  # where comments begin in the help


def setting_comments() -> dict[str, str]:
    """Return the comments of all settings by name, such as `estimate.beta`.

    If options of a group share a setting, the first comment is used.
    """
    return _comments_in_folders(conf_folders())


@cache
def _comments_in_folders(folders: tuple[Path, ...]) -> dict[str, str]:
    comments: dict[str, str] = {}
    files = [(CONF_FOLDER, CONF_FOLDER / "config.yaml")]
    for folder in folders:
        files += [(folder, file) for file in sorted(folder.rglob("*/*.yaml"))]
    for folder, file in files:
        if file.relative_to(folder).parts[0] == "experiment":
            continue
        for name, comment in comments_in_file(file, folder):
            comments.setdefault(name, comment)

    defaults = (CONF_FOLDER / "config.yaml").read_text(encoding="utf-8")
    for group, new_group in RENAMED_GROUP.findall(defaults):
        for name in list(comments):
            if name.startswith(f"{group}."):
                comments[new_group + name.removeprefix(group)] = comments[name]
    return comments


def setting_units(names: Iterable[str]) -> dict[str, str]:
    """Return the units of those settings that have one, by name."""
    units = {}
    for name in names:
        unit = re.search(r"\[([^\]]+)\]", setting_comments().get(name, ""))
        if unit and unit[1] != "1":
            units[name] = unit[1]
    return units


def comments_in_file(file: Path, folder: Path) -> Iterator[tuple[str, str]]:
    """Yield the full name and the comment of each commented setting in a file.

    `folder` is that of all settings, around the file.
    """
    text = file.read_text(encoding="utf-8")
    is_top_level = file.parent == folder or "@package _global_" in text
    block = "" if is_top_level else file.parent.relative_to(folder).as_posix()
    name, comment = "", ""
    for line, next_name, next_comment in named_lines(text, block):
        if next_name:
            if comment:
                yield name, comment
            name, comment = next_name, next_comment
        elif comment and (continued := CONTINUED_COMMENT.match(line)):
            comment += f" {continued[1]}"
    if comment:
        yield name, comment


def annotate_settings(text: str) -> Iterator[str]:
    """Yield the lines of settings as YAML, each followed by the setting's comment."""
    for line, name, _ in named_lines(text):
        comment = setting_comments().get(name, "")
        yield f"{line:<{COMMENT_COLUMN}}# {comment}" if comment else line


def named_lines(text: str, block: str = "") -> Iterator[tuple[str, str, str]]:
    """Yield each line of YAML with the full name and comment of its setting, if any.

    block: name of the block around them.
    """
    # indent and name of each block around the line
    parents = [(-1, block)] if block else []
    for line in text.splitlines():
        setting = SETTING_LINE.match(line)
        if setting is None:
            yield line, "", ""
            continue
        indent = len(setting["indent"])
        parents = [(depth, name) for depth, name in parents if depth < indent]
        parents.append((indent, setting["name"]))
        full_name = ".".join(name for _, name in parents)
        yield line, full_name, setting["comment"] or ""
