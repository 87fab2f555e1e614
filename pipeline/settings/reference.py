"""The reference of all settings: `python -m pipeline.settings.reference` writes
conf/README.md anew.

It is made of what is there: the files of `conf` with their comments, the types of what
takes their values, and the effects of the library.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any, get_type_hints

import yaml
from hydra import compose, initialize_config_dir
from pydantic import PydanticSchemaGenerationError, PydanticUserError, TypeAdapter

from stringcast.data.store import write_text
from stringcast.pipeline.settings.setting_comments import (
    comments_in_file,
    setting_comments,
)
from stringcast.pipeline.settings.typed_settings import (
    CONF_FOLDER,
    compose_settings,
    flatten_settings,
    load_callable,
    setting_types,
)
from stringcast.stages.calibrate.board import Board
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.box import Box
from stringcast.stages.model.camera import Camera
from stringcast.stages.model.library import effects_by_name
from stringcast.stages.model.string import String

PAGE = CONF_FOLDER / "README.md"
HEAD = """\
# All settings
Made by `python -m pipeline.settings.reference` of the files in this folder, of the types that take their values and of the \
library of effects; a test fails where it is out of date. `python -m pipeline --help` shows the settings of a call as \
they are then.

A setting is given by its name, `target.x=0.45`; a group of settings by one of its options, which is a file here, \
`estimate=cma_es`; an experiment is added, `+experiment=stringA`. A list is quoted, `'effects=[tip_mass,wind]'`; \
several values are a sweep, `--multirun seed=0,1,2`. Units are in brackets.
"""
RUN = "## Of the run\nIn `config.yaml`.\n"
EFFECTS = """\
## Effects
What can be so beyond the paper, `'effects=[wind]'`; one that the paper has is always there. A parameter is sought \
within its range. It is known by `'+known.tip_mass.ratio=0.05'`, or with an interval by \
`'+known.wind.along_x={value: 1, low: 0.8, high: 1.2}'`. [How they are simulated](../stages/model/README.md).
"""
# by their fields
BUILT = {"arm": Arm, "camera": Camera, "board": Board, "target": Box, "string": String}
# what code a block is of: an option says it in words
UNTOLD = {"_target_", "integrator", "_partial_"}
RANGE = {"low", "high", "start"}
LIMITS = {
    "exclusiveMinimum": "above",
    "minimum": "at least",
    "exclusiveMaximum": "below",
    "maximum": "at most",
}
KINDS = {"integer": "whole", "string": "text", "boolean": "true or false"}


def page() -> str:
    """The page as text."""
    with initialize_config_dir(str(CONF_FOLDER), version_base="1.3"):
        chosen = compose("config", return_hydra_config=True).hydra.runtime.choices
    settings = compose_settings()
    groups = [group for group in settings if (CONF_FOLDER / group).is_dir()]
    others = {
        name: value
        for name, value in settings.items()
        if name not in groups and name != "plane"
    }
    rows = [
        (f"`{name}`", _value(value), setting_comments().get(name, ""))
        for name, value in others.items()
    ]
    parts = [HEAD, RUN, _table(("setting", "default", "what it means"), rows)]
    parts += [_options("experiment", ""), _options("method", chosen["method"])]
    parts += [
        part
        for group in groups
        for part in _group(group, chosen[group], settings[group])
    ]
    parts += [_options("hydra/launcher", "serial"), EFFECTS]
    # every effect with its parameters, the base of the model first
    told: list[tuple[str, ...]] = []
    for effect in sorted(
        effects_by_name().values(),
        key=lambda one: (not any(p.symbol for p in one.parameters), one.name),
    ):
        words = " ".join((effect.__doc__ or "").partition("\n\n")[0].split())
        words += " A diagnosis does not look for it." * effect.excluded_from_search
        told += [(f"`{effect.name}`", words, "", "", "")]
        told += [
            (
                "",
                p.meaning,
                f"`{effect.qualified_name(p)}`",
                f"{p.low:g} to {p.high:g}",
                p.unit,
            )
            for p in effect.parameters
        ]
    return "\n".join(
        [*parts, _table(("effect", "what it is", "parameter", "range", "unit"), told)]
    )


def _group(group: str, chosen: str, block: Mapping[str, Any]) -> Iterator[str]:
    """A group: its options, then the settings of the chosen one, then what only others
    have.
    """
    yield _options(group, chosen)
    others = sorted(
        (CONF_FOLDER / group).glob("*.yaml"),
        key=lambda file: (b"defaults:" in file.read_bytes(), file.stem),
    )
    # those that begin from others, last
    listed = [CONF_FOLDER / group / f"{chosen}.yaml", *others]
    known: set[str] = set()
    rows = []
    for option, settings in (
        (file.stem, block if file.stem == chosen else _read(file)) for file in listed
    ):
        hints: Mapping[str, Any] = {}  # of what takes the settings
        if "_target_" in settings:
            hints = setting_types(
                load_callable(settings["_target_"], group, str(CONF_FOLDER / group))
            )
        elif group in BUILT:
            hints = get_type_hints(BUILT[group], include_extras=True)
        own, kinds = (
            dict(comments_in_file(CONF_FOLDER / group / f"{option}.yaml")),
            dict(_of_fields(group, hints)),
        )
        for name, value in flatten_settings(_folded(settings), group).items():
            if (
                any(name == one or name.startswith(f"{one}.") for one in known)
                or {*name.split(".")} & UNTOLD
            ):
                continue
            known.add(name)
            where = "" if option == chosen else f" (`{group}={option}`)"
            # without a comment of its own, that of a setting called alike elsewhere, or
            # of the block that it is in
            parts = name.split(".")
            alike = [
                one
                for one in setting_comments()
                if len(parts) > 2 and one.endswith(f".{'.'.join(parts[-2:])}")
            ]
            names = [
                name,
                *alike,
                *(".".join(parts[:end]) for end in range(len(parts) - 1, 1, -1)),
            ]
            said = own.get(name) or next(
                (setting_comments()[one] for one in names if one in setting_comments()),
                "",
            )
            rows.append((f"`{name}`", _value(value) + where, kinds.get(name, ""), said))
    if rows:
        yield _table(("setting", "default", "", "what it means"), rows)


def _read(file: Path) -> dict[str, Any]:
    """The settings of an option, with those of the options that it begins from."""
    block = yaml.safe_load(file.read_text(encoding="utf-8")) or {}
    before = [
        name
        for name in block.pop("defaults", [])
        if isinstance(name, str) and name != "_self_"
    ]
    inherited = [_read(file.with_name(f"{name}.yaml")) for name in before]
    return {name: value for one in (*inherited, block) for name, value in one.items()}


def _folded(block: Any) -> Any:
    """Settings in which the range of a parameter is one value."""
    if not isinstance(block, Mapping):
        return block
    if block.keys() >= RANGE:
        return "{low:g} to {high:g}, begun at {start:g}".format(**block)
    return {name: _folded(value) for name, value in block.items()}


def _options(group: str, chosen: str) -> str:
    """Heading and options of a group, each with what stands on top of its file."""
    rows = []
    for file in sorted(
        (CONF_FOLDER / group).glob("*.yaml"),
        key=lambda file: (file.stem != chosen, file.stem),
    ):
        lines = [
            line
            for line in file.read_text(encoding="utf-8").splitlines()
            if not line.startswith("# @package")
        ]
        top = re.match(r"(?:#.*\n)*", "\n".join([*lines, ""]))
        heading = " ".join(
            line.strip("# ") for line in (top[0] if top else "").splitlines()
        )
        rows.append((f"`{file.stem}`{', by default' * (file.stem == chosen)}", heading))
    return f"## `{'+' * (group == 'experiment')}{group}=`\n{_table(('option', 'what it is'), rows)}"


def _of_fields(place: str, hints: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """The values of each field in words, `whole, from 1 to 255`; nothing for what is no
    number, text or list of these.
    """
    for name, hint in hints.items():
        if is_dataclass(hint):
            yield from _of_fields(
                f"{place}.{name}", get_type_hints(hint, include_extras=True)
            )
            continue
        try:
            yield f"{place}.{name}", _said(TypeAdapter(hint).json_schema())
        # of a class of ours, whose fields are settings
        except (PydanticSchemaGenerationError, PydanticUserError):
            yield f"{place}.{name}", ""


def _said(schema: Mapping[str, Any]) -> str:
    if "anyOf" in schema:
        return " or ".join(filter(None, map(_said, schema["anyOf"])))
    if schema.get("type") == "array" and "maxItems" in schema:
        return f"{schema['maxItems']} numbers"
    if schema.get("type") == "array":
        return f"list, each {inside}" if (inside := _said(schema["items"])) else "list"
    limits = [
        f"{word} {schema[name]:g}" for name, word in LIMITS.items() if name in schema
    ]
    return ", ".join(filter(None, (KINDS.get(schema.get("type", ""), ""), *limits)))


def _value(value: Any) -> str:
    """The value as it is given on the command line."""
    said = (
        value
        if isinstance(value, str)
        else yaml.safe_dump([value], default_flow_style=True, width=1000)[1:-2]
    )
    return f"`{said}`"


def _table(columns: Sequence[str], rows: Sequence[tuple[str, ...]]) -> str:
    """A table in Markdown, in which a bar would end a cell and what looks like a tag
    would not be seen.
    """
    escaped = ([re.sub(r"([|<])", r"\\\1", cell) for cell in row] for row in rows)
    lines = [columns, ("---",) * len(columns), *escaped]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


if __name__ == "__main__":
    write_text(PAGE, page())
