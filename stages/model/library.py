"""The library: every effect there is, found by looking, with nothing to register."""

from __future__ import annotations

import difflib
import importlib.util
import os
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from stringcast.stages.model import effects as package
from stringcast.stages.model.effect import Effect, numbered_effect

# folders with more effects, separated as in PATH
EFFECTS_VARIABLE = "STRINGCAST_EFFECTS"
# effects of a model: three times the library; the generated loop nests an expression
# for each
MAX_EFFECTS = 100


class UnknownEffectError(ValueError):
    """Raised where there is no effect of that name, or more than one; the message lists
    those there are.
    """


def effects_by_name() -> dict[str, type[Effect]]:
    """All effects by name: those of `stages/model/effects` and of the folders in
    STRINGCAST_EFFECTS.

    Raises ValueError for a file that does not hold exactly one effect of its own name,
    and for two effects of the same name.
    """
    return {name: _load_effect(path) for name, path in effect_files().items()}


def find_effects(names: Sequence[str]) -> tuple[type[Effect], ...]:
    """The effects of these names; `maxwell_slip_2` is a second one of its kind. Raises
    UnknownEffectError.
    """
    if len(names) > MAX_EFFECTS:
        raise UnknownEffectError(
            f"{len(names)} effects are asked for, {MAX_EFFECTS} at most are compiled into one loop"
        )
    known = effects_by_name()
    asked = [(known[kind], number) for kind, number in map(split_effect_name, names)]
    return tuple(
        effect if number == 1 else numbered_effect(effect, number)
        for effect, number in asked
    )


def check_effect_names(names: Sequence[str]) -> Sequence[str]:
    """Names of effects, as they are. Raises UnknownEffectError where there is none of
    that name.
    """
    find_effects(names)
    return names


def split_effect_name(name: str) -> tuple[str, int]:
    """The kind of an effect, which is the name of its file, and which of this kind it
    is: `maxwell_slip` and 2 of `maxwell_slip_2`. Raises UnknownEffectError.
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
    """The file of each effect, by name, none of them loaded. Raises ValueError as
    `library`.
    """
    found: dict[str, Path] = {}
    more = filter(None, os.environ.get(EFFECTS_VARIABLE, "").split(os.pathsep))
    for folder in (Path(package.__path__[0]), *map(Path, more)):
        if not folder.is_dir():
            raise ValueError(
                f"{EFFECTS_VARIABLE}: there is no folder {folder}. Correct the path."
            )
        for path in sorted(
            p.resolve() for p in folder.glob("*.py") if not p.name.startswith("_")
        ):
            if path.stem in found:
                raise ValueError(
                    f"{path}: there is an effect '{path.stem}' already. Rename the file and its effect."
                )
            found[path.stem] = path
    return found


@cache
def _load_effect(path: Path) -> type[Effect]:
    """The one effect of a file."""
    if path.parent == Path(package.__path__[0]).resolve():
        module = importlib.import_module(f"{package.__name__}.{path.stem}")
    else:
        specification = importlib.util.spec_from_file_location(
            f"effects_elsewhere.{path.stem}", path
        )
        assert specification is not None
        assert specification.loader is not None
        module = importlib.util.module_from_spec(specification)
        # inspect looks there for the text of laws
        sys.modules[module.__name__] = module
        specification.loader.exec_module(module)
    mine = [
        c
        for c in vars(module).values()
        if isinstance(c, type) and c.__module__ == module.__name__
    ]
    effects = [c for c in mine if issubclass(c, Effect)]
    if [getattr(e, "name", "") for e in effects] != [path.stem]:
        raise ValueError(
            f"{path}: it must hold one effect, with name = '{path.stem}'. See stages/model/effect.py."
        )
    if effects[0].__abstractmethods__ or not hasattr(effects[0], "reference"):
        missing = ", ".join(sorted(effects[0].__abstractmethods__)) or "reference"
        raise ValueError(
            f"{path}: the effect lacks {missing}. See stages/model/effect.py."
        )
    return effects[0]
