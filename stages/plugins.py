"""Plugins: folders of a person's own with effects, stages, functions and settings.

A plugin is a folder such as `my_lab`, beside or far from this package. Its modules are
imported as `stringcast.plugins.my_lab...`, so that they hide no installed package. Only
folders that this person named are ever imported: those in STRINGCAST_PLUGINS, to which
the command line adds those of the setting `plugins`.
"""

from __future__ import annotations

import ast
import difflib
import importlib
import os
import re
import sys
from collections.abc import Sequence
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

from stringcast.data.errors import ExpectedError

PLUGINS_VARIABLE = "STRINGCAST_PLUGINS"  # folders, separated as in PATH
PLUGIN_PREFIX = "plugins."  # of names in settings and in descriptions of stages
PACKAGE = "stringcast.plugins"
NAME_PATTERN = re.compile(r"[a-z][a-z0-9_]*")


class PluginError(ExpectedError, ValueError):
    """A plugin that is missing or cannot be used."""


def plugin_folders() -> dict[str, Path]:
    """Return the folders of the plugins that this person named, by their names.

    Raises PluginError for a folder that does not exist or has no name of a package, and
    for two folders of one name.
    """
    folders: dict[str, Path] = {}
    for text in filter(None, os.environ.get(PLUGINS_VARIABLE, "").split(os.pathsep)):
        folder = Path(text).resolve()
        if not folder.is_dir():
            fault = "there is no such folder"
            raise PluginError(f"plugin {text}", fault, _suggest_folder(folder))
        if not NAME_PATTERN.fullmatch(folder.name):
            raise PluginError(
                f"plugin {text}",
                "the name of its folder must consist of small letters, digits and _",
                "Rename it.",
            )
        if folders.setdefault(folder.name, folder) != folder:
            raise PluginError(
                f"plugins {folders[folder.name]} and {folder}",
                "they have the same name",
                "Rename one folder.",
            )
    return folders


def _suggest_folder(folder: Path) -> str:
    """Suggest a folder of a similar name beside a missing one."""
    try:
        others = [path.name for path in folder.parent.iterdir() if path.is_dir()]
    except OSError:
        others = []
    if near := difflib.get_close_matches(folder.name, others, 1):
        return f"Did you mean '{near[0]}'?"
    return "Correct the path."


def plugin_files(pattern: str) -> dict[Path, str]:
    """Find files of all plugins, each with the name of its module.

    Parameters
    ----------
    pattern : str
        Pattern of paths within a plugin, such as ``effects/*.py``. Files whose names
        begin with ``_`` are left out, except for ``__init__.py``.
    """
    modules: dict[Path, str] = {}
    for name, folder in plugin_folders().items():
        for file in sorted(folder.glob(pattern)):
            parts = file.relative_to(folder).with_suffix("").parts
            if parts[-1] == "__init__":
                parts = parts[:-1]
            if not parts[-1].startswith("_"):
                modules[file] = ".".join(("plugins", name, *parts))
    return modules


def plugin_sources() -> dict[str, Path]:
    """Return all files of all plugins, by the plugin's name and their paths.

    Data files count as well as code: a stage may read them. Hidden files and compiled
    ones are left out.
    """
    sources = {}
    for name, folder in plugin_folders().items():
        # links of folders are followed, as an import follows them
        for place, folders, files in os.walk(folder, followlinks=True):
            if is_inside_itself(Path(place)):
                folders.clear()
                continue
            folders[:] = [f for f in folders if not f.startswith((".", "__pycache__"))]
            for file in files:
                path = Path(place, file)
                if path.is_file() and not file.startswith("."):
                    relative = path.relative_to(folder).as_posix()
                    sources[f"{PLUGIN_PREFIX}{name} {relative}"] = path
    return sources


def is_inside_itself(folder: Path) -> bool:
    """Return whether a folder is a link to one that contains it."""
    return folder.is_symlink() and folder.absolute().is_relative_to(folder.resolve())


def public_definitions(
    file: Path, kind: type[ast.FunctionDef] | type[ast.ClassDef]
) -> list[str]:
    """Return the names of a file's own public functions or classes.

    The file is read, not imported.
    """
    try:
        tree = ast.parse(file.read_text(encoding="utf-8"))
    except (SyntaxError, ValueError) as error:
        raise _import_error(file.as_posix(), error) from error
    names = [node.name for node in tree.body if isinstance(node, kind)]
    return [name for name in names if not name.startswith("_")]


def load_object(name: str) -> Any:
    """Return a function or class by its name within `stringcast`.

    Parameters
    ----------
    name : str
        Such as ``stages.estimate.cma_es.estimate``, or
        ``plugins.my_lab.estimate.mine.estimate`` of a plugin.

    Raises
    ------
    PluginError
        If a plugin lacks it or cannot be imported.
    """
    module_name, _, attribute = name.rpartition(".")
    if not name.startswith(PLUGIN_PREFIX):
        return getattr(importlib.import_module(f"stringcast.{module_name}"), attribute)
    module = import_plugin_module(module_name)
    if not hasattr(module, attribute):
        raise PluginError(
            name,
            f"{module.__file__} has no {attribute}",
            suggest_name(attribute, [*vars(module)]),
        )
    return getattr(module, attribute)


def suggest_name(name: str, known: Sequence[str]) -> str:
    """Suggest the nearest known name, or to correct a name that resembles none."""
    if near := difflib.get_close_matches(name, known, 1):
        return f"Did you mean '{near[0]}'?"
    return "Correct the name."


def import_plugin_module(name: str) -> ModuleType:
    """Import a module of a plugin, such as `plugins.my_lab.effects.side_pull`.

    Raises PluginError with the module's own error.
    """
    full_name = f"stringcast.{name}"
    try:
        for plugin, folder in plugin_folders().items():
            _register_plugin(plugin, folder)
        if full_name not in sys.modules:
            importlib.invalidate_caches()  # a file may be new
        return importlib.import_module(full_name)
    except PluginError:
        raise
    except (Exception, SystemExit) as error:
        raise _import_error(name, error) from error


def _import_error(place: str, error: BaseException) -> PluginError:
    """Return the error of a plugin that cannot be imported, with its own error."""
    return PluginError(
        place,
        f"it cannot be imported ({type(error).__name__}: {error})",
        "Correct it, or leave its plugin out; nothing was run.",
    )


def _register_plugin(name: str, folder: Path) -> None:
    """Make a folder the package `stringcast.plugins.<name>`."""
    full_name = f"{PACKAGE}.{name}"
    known = sys.modules.get(full_name)
    if known is not None and [*known.__path__] == [str(folder)]:
        return
    for module_name in [*sys.modules]:  # another folder of that name was named before
        if f"{module_name}.".startswith(f"{full_name}."):
            del sys.modules[module_name]

    root = sys.modules.setdefault(PACKAGE, ModuleType(PACKAGE))
    root.__path__ = []
    package = ModuleType(full_name)
    package.__path__ = [str(folder)]
    file = folder / "__init__.py"
    specification = None
    if file.is_file():
        specification = spec_from_file_location(
            full_name, file, submodule_search_locations=[str(folder)]
        )
    if specification is not None and specification.loader is not None:
        package = module_from_spec(specification)
        sys.modules[full_name] = package
        try:
            specification.loader.exec_module(package)
        except BaseException:
            del sys.modules[full_name]  # as Python does for a module that fails
            raise
    sys.modules[full_name] = package
    setattr(root, name, package)
