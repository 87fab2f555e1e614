"""Compose settings from the files of `conf` and the overrides of a command line."""

from __future__ import annotations

import copy
import functools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_dir
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import OmegaConf

from stringcast.data.errors import ExpectedError
from stringcast.stages.plugins import PluginError, plugin_folders

Settings = Mapping[str, Any]  # of a run or a block, by name
CONF_FOLDER = Path(__file__).resolve().parents[2] / "conf"
PLUGINS_SETTING = "plugins"


class UserError(ExpectedError):
    """A setting or an argument that cannot be used."""


def compose_settings(overrides: Sequence[str] = ()) -> Any:
    """Compose all settings outside a run, as plain values.

    Overrides are as on the command line, such as ``seed=3``.
    """
    settings = copy.deepcopy(_compose_cached(tuple(overrides), conf_folders()))
    settings[PLUGINS_SETTING] = named_folders()
    return settings


def named_folders() -> list[str]:
    """Return the folders of all plugins named by the user."""
    return [str(folder) for folder in plugin_folders().values()]


def conf_folders() -> tuple[Path, ...]:
    """Return the folders of settings of the package and of plugins.

    Raises PluginError for two files of the same name.
    """
    folders = [CONF_FOLDER]
    for plugin in plugin_folders().values():
        conf = plugin / "conf"
        for file in conf.rglob("*.yaml"):
            for folder in folders:
                if (folder / file.relative_to(conf)).exists():
                    raise PluginError(
                        file,
                        f"{folder} has a file of this name, too",
                        "Rename it.",
                    )
        if conf.is_dir():
            folders.append(conf)
    return tuple(folders)


def group_files(group: str) -> list[Path]:
    """Return the option files of a group, from the package and plugins."""
    files = []
    for folder in conf_folders():
        files += sorted((folder / group).glob("*.yaml"))
    return files


@functools.cache
def _compose_cached(overrides: tuple[str, ...], folders: tuple[Path, ...]) -> Any:
    # Hydra takes 0.1 s; all jobs of a study compose the same settings.
    refuse_repeated_settings(overrides)
    with initialize_config_dir(str(CONF_FOLDER), version_base="1.3"):
        try:
            return OmegaConf.to_container(compose("config", list(overrides)))
        except ValueError as error:
            fault = " ".join(str(error).split())
            raise UserError(
                " ".join(overrides),
                f"these settings do not fit together ({fault})",
                "Correct them.",
            ) from error


def given_names(overrides: Iterable[str]) -> set[str]:
    """Return the names of the settings that overrides give."""
    return {override.split("=")[0].lstrip("+~") for override in overrides}


def refuse_repeated_settings(overrides: Iterable[str]) -> None:
    """Raise UserError for a setting given twice."""
    seen: dict[tuple[str, str | None], str] = {}
    for override in OverridesParser.create().parse_overrides(list(overrides)):
        if override.is_delete():
            continue
        key = override.key_or_group, override.package
        if key in seen:
            raise UserError(
                f"{seen[key]} and {override.input_line} (command line)",
                "the setting is given twice",
                "Remove one.",
            )
        seen[key] = str(override.input_line)


def setting_names(block: Any, prefix: str = "") -> Iterator[str]:
    """Yield the full names of all settings and blocks in nested settings."""
    for name, value in block.items():
        yield f"{prefix}{name}"
        if isinstance(value, dict):
            yield from setting_names(value, f"{prefix}{name}.")


def setting_of(settings: Settings, name: str) -> Any:
    """Return a setting by its full name, such as `estimate.inputs`; None without it."""
    value: Any = settings
    for part in name.split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    return value


def flatten_settings(block: Any, prefix: str = "") -> dict[str, Any]:
    """Return every value of nested settings by its full name."""
    if not isinstance(block, dict) or not block:
        return {prefix: block}
    values: dict[str, Any] = {}
    for name, inner_block in block.items():
        full_name = f"{prefix}.{name}" if prefix else name
        values |= flatten_settings(inner_block, full_name)
    return values
