"""The library: every effect there is, found by looking, with nothing to register."""

from __future__ import annotations

import difflib
import importlib
import os
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from stringcast.stages.common import import_file
from stringcast.stages.model import effects as package
from stringcast.stages.model.effect import Effect, numbered_effect

EFFECTS_VARIABLE = "STRINGCAST_EFFECTS"  # folders with more effects, as in PATH
# Of a model: three times the library; the generated loop nests an expression for each.
MAX_EFFECTS = 100


class UnknownEffectError(ValueError):
    """There is no effect of that name; the message helps to find one."""


def effects_by_name() -> dict[str, type[Effect]]:
    """Load all effects, by name.

    Those of `stages/model/effects` and of the folders in STRINGCAST_EFFECTS.

    Raises
    ------
    ValueError
        For a file that does not hold exactly one effect of its own name, and for two
        effects of the same name.
    """
    return {name: _load_effect(path) for name, path in effect_files().items()}


def find_effects(names: Sequence[str]) -> tuple[type[Effect], ...]:
    """Find effects by name; `maxwell_slip_2` is a second one of its kind.

    Raises
    ------
    UnknownEffectError
        If there is none of that name, or there are too many.
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
    """Return names of effects as they are.

    Raises
    ------
    UnknownEffectError
        If there is no effect of a name.
    """
    find_effects(names)
    return names


def split_effect_name(name: str) -> tuple[str, int]:
    """Split a name into kind and number: `maxwell_slip` and 2 of `maxwell_slip_2`.

    The kind is the name of the effect's file.

    Raises
    ------
    UnknownEffectError
        If there is no such kind.
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
        f"there is no effect '{name}'. {hint}All of them: python -m pipeline --help"
    )


def effect_files() -> dict[str, Path]:
    """Find the file of each effect, by name, none of them loaded.

    Raises
    ------
    ValueError
        For a folder that does not exist, and for two effects of the same name.
    """
    files: dict[str, Path] = {}
    further = filter(None, os.environ.get(EFFECTS_VARIABLE, "").split(os.pathsep))
    for folder in (Path(package.__path__[0]), *map(Path, further)):
        if not folder.is_dir():
            raise ValueError(
                f"{EFFECTS_VARIABLE}: there is no folder {folder}. Correct the path."
            )
        for path in sorted(path.resolve() for path in folder.glob("[!_]*.py")):
            if path.stem in files:
                raise ValueError(
                    f"{path}: there is an effect '{path.stem}' already. Rename the "
                    "file and its effect."
                )
            files[path.stem] = path
    return files


@cache
def _load_effect(path: Path) -> type[Effect]:
    """Load the one effect of a file."""
    if path.parent == Path(package.__path__[0]).resolve():
        module = importlib.import_module(f"{package.__name__}.{path.stem}")
    else:
        module = import_file(f"effects_elsewhere.{path.stem}", path)
    effects = []
    for member in vars(module).values():
        if not isinstance(member, type) or member.__module__ != module.__name__:
            continue
        if issubclass(member, Effect):
            effects.append(member)
    if [getattr(effect, "name", "") for effect in effects] != [path.stem]:
        raise ValueError(
            f"{path}: it must hold one effect, with name = '{path.stem}'. See "
            "stages/model/effects/README.md."
        )
    effect = effects[0]
    if effect.__abstractmethods__ or not hasattr(effect, "reference"):
        missing = ", ".join(sorted(effect.__abstractmethods__)) or "reference"
        raise ValueError(
            f"{path}: the effect lacks {missing}. See stages/model/effects/README.md."
        )
    return effect
