"""The library of effects, found in files; nothing is registered."""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from stringcast.stages.model import effects as package
from stringcast.stages.model.effect import Effect, numbered_effect
from stringcast.stages.plugins import PluginError, import_plugin_module, plugin_files

# Three times the library. The generated loop nests one expression for each effect.
MAX_EFFECTS = 100
PLUGIN_EFFECTS = "effects/*.py"  # files of effects in the folder of a plugin


class UnknownEffectError(ValueError):
    """No effect has that name; the message suggests others."""


def effects_by_name() -> dict[str, type[Effect]]:
    """Load all effects, by name.

    They are in `stages/model/effects` and in the folders `effects` of plugins.

    Raises PluginError if a file does not hold exactly one effect of its own name, or
    two effects have the same name.
    """
    modules = plugin_files(PLUGIN_EFFECTS)
    effects = {}
    for name, path in effect_files().items():
        effects[name] = _load_effect(path, modules.get(path, ""))
    return effects


def find_effects(names: Sequence[str]) -> tuple[type[Effect], ...]:
    """Find effects by name; `maxwell_slip_2` is a second one of its kind.

    Raises UnknownEffectError if a name is unknown, or there are too many.
    """
    if len(names) > MAX_EFFECTS:
        raise UnknownEffectError(
            f"There are {len(names)} effects; at most {MAX_EFFECTS} fit into one loop."
        )
    known = effects_by_name()
    effects = []
    for name in names:
        kind, number = split_effect_name(name)
        effect = known[kind]
        effects.append(effect if number == 1 else numbered_effect(effect, number))
    return tuple(effects)


def check_effect_names(names: Sequence[str]) -> Sequence[str]:
    """Check names of effects, and return them unchanged.

    Raises UnknownEffectError if a name is unknown.
    """
    find_effects(names)
    return names


def split_effect_name(name: str) -> tuple[str, int]:
    """Split a name into kind and number: `maxwell_slip_2` into `maxwell_slip` and 2.

    The kind is the name of the effect's file. Raises UnknownEffectError if it is
    unknown.
    """
    known = effect_files()
    kind, _, number = name.rpartition("_")
    if name in known:
        return name, 1
    if kind in known and number.isdecimal() and int(number) > 1:
        return kind, int(number)
    near = difflib.get_close_matches(name, known, 1)
    hint = f"Did you mean '{near[0]}'? " if near else ""
    raise UnknownEffectError(
        f"there is no effect '{name}'. {hint}For one of a plugin, name its folder: "
        "plugins=[my_lab]. All others: python -m pipeline --help"
    )


def effect_files() -> dict[str, Path]:
    """Find the file of each effect, by name, without loading it.

    Raises PluginError if two effects have the same name.
    """
    files: dict[str, Path] = {}
    for path in (*_own_files(), *plugin_files(PLUGIN_EFFECTS)):
        if path.stem in files:
            raise PluginError(
                path,
                f"there is an effect '{path.stem}' already",
                "Rename the file and its effect.",
            )
        files[path.stem] = path
    return files


@cache
def _own_files() -> tuple[Path, ...]:
    """Find the files of the package's own effects, once."""
    return tuple(sorted(Path(package.__path__[0]).resolve().glob("[!_]*.py")))


@cache
def _load_effect(path: Path, plugin_module: str) -> type[Effect]:
    """Load the effect of a file of the package or of a plugin."""
    if plugin_module:
        module = import_plugin_module(plugin_module)
    else:
        module = importlib.import_module(f"{package.__name__}.{path.stem}")
    effects = []
    for member in vars(module).values():
        if not isinstance(member, type) or member.__module__ != module.__name__:
            continue
        if issubclass(member, Effect):
            effects.append(member)
    if [getattr(effect, "name", "") for effect in effects] != [path.stem]:
        raise PluginError(
            path,
            f"it must hold one effect, with name = '{path.stem}'",
            "See stages/model/effects/README.md.",
        )
    effect = effects[0]
    if effect.__abstractmethods__ or not hasattr(effect, "reference"):
        missing = ", ".join(sorted(effect.__abstractmethods__)) or "reference"
        raise PluginError(
            path,
            f"the effect lacks {missing}",
            "See stages/model/effects/README.md.",
        )
    return effect
