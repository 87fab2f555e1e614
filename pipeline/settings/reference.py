"""Generate the reference of all settings, conf/README.md.

`python -m pipeline.settings.reference` makes the page from the comments in the files of
`conf` and from the library of effects.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from hydra import compose, initialize_config_dir

from stringcast.data.store import write_text
from stringcast.pipeline.settings.composition import (
    CONF_FOLDER,
    compose_settings,
    flatten_settings,
)
from stringcast.pipeline.settings.setting_comments import setting_comments
from stringcast.stages.model.effect import Effect
from stringcast.stages.model.library import effects_by_name

PAGE_FILE = CONF_FOLDER / "README.md"
PAGE_HEAD = """\
# All settings
Which settings exist, and what are their defaults? Each group lists its options, then \
the settings of its default option. `python -m pipeline.settings.reference` writes \
this page; `python -m pipeline --help` shows one call.

    target.x=0.45                   a setting
    estimate=cma_es                 an option of a group
    +experiment=stringA             an experiment
    'effects=[tip_mass,wind]'       a list
    --multirun seed=0,1,2           a sweep
"""
EFFECTS_HEADING = """\
## Effects
The first seven, the paper's, are always active; `effects=` adds others. \
[How effects are simulated](../stages/model/README.md).

    '+parameter_values.tip_mass.ratio=0.05'                             a value
    '+parameter_values.wind.along_x={value: 1, low: 0.8, high: 1.2}'    an interval
"""
MEANING_COLUMN = 36  # where meanings begin


def reference_page() -> str:
    """Return the reference of all settings as Markdown."""
    with initialize_config_dir(str(CONF_FOLDER), version_base="1.3"):
        config = compose("config", return_hydra_config=True)
    default_options = config.hydra.runtime.choices
    settings = compose_settings()
    groups = [name for name in settings if (CONF_FOLDER / name).is_dir()]

    run_lines = []
    for name, value in settings.items():
        if name not in groups and name in setting_comments():
            run_lines.append(setting_line(name, value))

    sections = [PAGE_HEAD, section("Run", run_lines)]
    sections.append(section("`+experiment=`", option_lines("experiment", "")))
    for group in ("method", *groups):
        lines = option_lines(group, default_options[group])
        own_lines = setting_lines(group, settings.get(group, {}))
        if own_lines:
            lines += ["", *own_lines]
        sections.append(section(f"`{group}=`", lines))
    launcher_lines = option_lines("hydra/launcher", "serial")
    sections.append(section("`hydra/launcher=`", launcher_lines))

    effect_listing: list[str] = []
    for effect in sorted_effects():
        effect_listing += effect_lines(effect)
    return "\n".join([*sections, EFFECTS_HEADING, listing(effect_listing)])


def option_lines(group: str, default_option: str) -> list[str]:
    """List the options of a group, each with the first sentence of its file."""
    files = sorted(
        (CONF_FOLDER / group).glob("*.yaml"),
        key=lambda file: (file.stem != default_option, file.stem),
    )
    lines = []
    for file in files:
        default = " (default)" if file.stem == default_option else ""
        lines.append(meaning_line(f"{file.stem}{default}", first_sentence(file)))
    return lines


def first_sentence(file: Path) -> str:
    """Return the first sentence of a settings file."""
    for line in file.read_text(encoding="utf-8").splitlines():
        if line.startswith("# ") and not line.startswith("# @package"):
            return line.removeprefix("# ")
    return ""


def setting_lines(group: str, settings: Mapping[str, Any]) -> list[str]:
    """Describe each setting of a group, or the block around it that has a comment."""
    lines: dict[str, str] = {}
    for name, value in flatten_settings(settings, group).items():
        commented = nearest_comment(name)
        refers_to_setting = isinstance(value, str) and value.startswith("${")
        if commented and not refers_to_setting:
            shown_value = value if commented == name else None
            lines.setdefault(commented, setting_line(commented, shown_value))
    return list(lines.values())


def nearest_comment(name: str) -> str:
    """Return the name of the setting, or of the innermost block, with a comment."""
    while name and name not in setting_comments():
        name = name.rpartition(".")[0]
    return name


def sorted_effects() -> list[type[Effect]]:
    """Return all effects, those of the paper first."""

    def order(effect: type[Effect]) -> tuple[bool, str]:
        is_of_paper = any(parameter.symbol for parameter in effect.parameters)
        return not is_of_paper, effect.name

    return sorted(effects_by_name().values(), key=order)


def effect_lines(effect: type[Effect]) -> list[str]:
    """Describe an effect, and ranges and units of its parameters."""
    first_line = " ".join((effect.__doc__ or "").partition("\n\n")[0].split())
    sentence = re.split(r"\. (?=[A-Z])", first_line)[0].removesuffix(".")
    excluded = " Not a candidate." if effect.exclusion_reason else ""
    lines = [f"{effect.name}: {sentence}.{excluded}"]

    names_by_range: dict[str, list[str]] = {}
    for parameter in effect.parameters:
        unit = "" if parameter.unit == "1" else f" {parameter.unit}"
        range_text = f"{parameter.low:g}…{parameter.high:g}{unit}"
        names_by_range.setdefault(range_text, []).append(parameter.name)
    ranges = []
    for range_text, names in names_by_range.items():
        ranges.append(f"{', '.join(names)} {range_text}")
    if ranges:
        lines.append(f"    {'; '.join(ranges)}")
    return lines


def setting_line(name: str, value: Any) -> str:
    """Describe a setting in a line, with its value as on the command line."""
    item = name
    if isinstance(value, str):
        item += f"={value}"
    elif value is not None:
        text = yaml.safe_dump([value], default_flow_style=True, width=1000)
        item += f"={text[1:-2]}"
    return meaning_line(item, setting_comments()[name])


def meaning_line(item: str, meaning: str) -> str:
    """Return an item of a listing with its meaning in a column."""
    return f"{item:<{MEANING_COLUMN}}  {meaning}"


def section(heading: str, lines: Sequence[str]) -> str:
    """Return a heading with a listing."""
    return f"## {heading}\n{listing(lines)}"


def listing(lines: Sequence[str]) -> str:
    """Return lines as a block of code."""
    return "".join(f"    {line}".rstrip() + "\n" for line in lines)


if __name__ == "__main__":
    write_text(PAGE_FILE, reference_page())
