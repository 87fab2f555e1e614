"""The plugins of a run: only those named by the user, imported in advance.

The setting `plugins` of a command line extends the variable STRINGCAST_PLUGINS,
inherited by processes of a sweep. A stored run never extends it.
"""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser

from stringcast.pipeline.settings.allowed_callables import plugin_function_files
from stringcast.pipeline.settings.composition import (
    PLUGINS_SETTING,
    Settings,
    UserError,
    named_folders,
)
from stringcast.pipeline.settings.stage_registry import stages
from stringcast.stages.model.library import effects_by_name
from stringcast.stages.plugins import (
    PLUGIN_PREFIX,
    PLUGINS_VARIABLE,
    import_plugin_module,
    load_object,
    plugin_files,
    plugin_folders,
)

UNNAMED_PLUGIN = "which you have not named"  # part of messages


def name_plugins(overrides: Sequence[str]) -> None:
    """Register the plugins of a command line, for this process and its children.

    Raises UserError or PluginError for anything but a list of usable folders.
    """
    start = f"{PLUGINS_SETTING}="
    words = [word for word in overrides if word.lstrip("+").startswith(start)]
    for override in OverridesParser.create().parse_overrides(words):
        value = override.value()
        text = str(override.input_line)
        if override.is_sweep_override():
            raise UserError(text, "a sweep has one list of plugins", "Give only one.")
        if not isinstance(value, list):
            folders = text.partition("=")[2].strip("[]")
            raise UserError(
                text,
                "this is a list of folders",
                f"Try: {shlex.quote(f'{PLUGINS_SETTING}=[{folders}]')}",
            )
        for folder in map(str, value):
            if os.pathsep in folder or not is_path(folder):
                raise UserError(
                    f"plugin {folder}",
                    f"the path may not hold {os.pathsep!r}, which separates "
                    f"paths in {PLUGINS_VARIABLE}",
                    "Rename the folder.",
                )
        set_plugins([*named_folders(), *map(str, value)])


def set_plugins(folders: Sequence[str]) -> None:
    """Set the plugins of this process and its children; check their folders."""
    os.environ[PLUGINS_VARIABLE] = os.pathsep.join(folders)
    os.environ[PLUGINS_VARIABLE] = os.pathsep.join(named_folders())


def require_named_plugins(settings: Settings, where: str) -> list[str]:
    """Return the folders of the plugins in settings, perhaps of a foreign run.

    `where` is the file of the settings, for messages. Raises UserError for a plugin
    that the user has not named. It is not imported.
    """
    stored: Any = settings.get(PLUGINS_SETTING, [])
    is_list = isinstance(stored, list)
    if not is_list or not all(is_path(text) for text in stored):
        raise UserError(
            f"{PLUGINS_SETTING} = {stored!r} ({where})",
            "it must be a list of folders",
            "Change it.",
        )
    named = plugin_folders()
    missing = [text for text in stored if Path(text).resolve().name not in named]
    if missing:
        folders = os.pathsep.join([*named_folders(), *missing])
        raise UserError(
            f"{PLUGINS_SETTING} ({where})",
            f"the run uses code of the plugin {' and '.join(missing)}, "
            f"{UNNAMED_PLUGIN}",
            "Nothing of it was imported. If you trust it, name your copy before "
            f"the command: {PLUGINS_VARIABLE}={shlex.quote(folders)}",
        )
    return [str(named[Path(text).resolve().name]) for text in stored]


def is_path(value: Any) -> bool:
    """Return whether a value may be a path."""
    return isinstance(value, str) and "\0" not in value


def use_stored_plugins(settings: Settings, where: str) -> None:
    """Use exactly the plugins of a stored run; the user must have named them."""
    folders = require_named_plugins(settings, where)
    if folders != named_folders():
        set_plugins(folders)


@contextmanager
def stored_plugins(settings: Settings, where: str) -> Iterator[None]:
    """Within the context, use exactly the plugins of a stored run."""
    before = named_folders()
    try:
        use_stored_plugins(settings, where)
        yield
    finally:
        set_plugins(before)


def import_plugins() -> None:
    """Import all modules of plugins, so that faults appear before a run.

    Raises PluginError for a module that cannot be imported, or a missing name.
    """
    if not plugin_folders():
        return
    effects_by_name()
    for module in (*plugin_files("stages/*/*.py").values(), *plugin_function_files()):
        import_plugin_module(module)
    for stage in stages().values():
        for name in (stage.run, stage.page, *stage.by):
            if name.startswith(PLUGIN_PREFIX):
                load_object(name)
