"""Which source files a result depends on: those of its stage, and what they import, however far."""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from stringcast.pipeline.origin import CODE, ROOT
from stringcast.pipeline.settings import allowed
from stringcast.stages.model.library import files, kind_of
from stringcast.stages.spec import StageSpec

GLUE = ("pipeline/iterations.py", "pipeline/experiment.py", "stages/spec.py")  # they hand every stage what it is given
LIBRARY = ROOT / "stages" / "model" / "library.py"  # it imports every effect without naming any
MODEL = "stages/model/model.py"


def sources(settings: Mapping[str, Any], stage: StageSpec) -> dict[str, str]:
    """Hashes of the code behind a step, by the path of its file. settings: those that it uses."""
    named = [allowed(target, role, "config.json") for role, target in targets(settings)]
    roots = {home(name) for name in (*named, stage.run)}
    roots |= {ROOT / MODEL} if "string" in settings else set()
    effects = files()
    roots |= {effects[kind_of(name)[0]] for name in settings.get("effects", [])}
    behind = closure(roots) | {ROOT / name for name in GLUE}
    return {_short(file): _digest(file) for file in sorted(behind)}


def home(target: str) -> Path:
    """The file in which a `_target_` of ours is defined, without loading it, which takes seconds: that of the module it
    is in, or of its own name, from where a package has it."""
    file = _file(f"stringcast.{target}") or _file(f"stringcast.{target.rpartition('.')[0]}")
    assert file is not None, f"{target} lies in no file of ours"
    return file


def targets(block: Any, role: str = "") -> Iterator[tuple[str, Any]]:
    """Every `_target_` in a block of settings, behind the name of the block that holds it."""
    if isinstance(block, Mapping):
        if "_target_" in block:
            yield role, block["_target_"]
        for name, value in block.items():
            yield from targets(value, name)


def closure(roots: Iterable[Path]) -> set[Path]:
    """Files, and all of ours that they import."""
    found: set[Path] = set()
    ahead = list(roots)
    while ahead:
        file = ahead.pop()
        if file not in found:
            found.add(file)
            ahead += () if _short(file) in GLUE else _imported(file)
    return found


def _imported(file: Path) -> tuple[Path, ...]:
    """Files of ours that a file imports itself, wherever in it."""
    return (*files().values(), *_read(file)[0]) if file == LIBRARY else _read(file)[0]


def _digest(file: Path) -> str:
    """Of the code as Python runs it: comments, line breaks and docstrings make no step stale."""
    return _read(file)[1]


@cache
def _read(file: Path) -> tuple[tuple[Path, ...], str]:
    """The files of ours that a file imports, and its digest: of one tree, for it takes as long to parse as all else."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    names: set[str] = set()
    for node in (tree, *_statements(tree)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node, clean=False):
            del node.body[0]
    packages = {".".join(name.split(".")[:end]) for name in names for end in range(1, name.count(".") + 2)}
    imported = tuple(path for name in sorted(packages) if (path := _file(name)) is not None)
    return imported, hashlib.sha256(ast.dump(tree).encode()).hexdigest()[:16]


def _statements(node: ast.AST) -> Iterator[ast.stmt]:
    """All statements within one, however deep; expressions, which are most of a file, hold none."""
    for field in ("body", "orelse", "finalbody", "handlers", "cases"):
        inside = getattr(node, field, ())
        for one in inside if isinstance(inside, list) else ():
            yield one
            yield from _statements(one)


def _file(module: str) -> Path | None:
    """The file of a module of ours; None for others'."""
    package, *parts = module.split(".")
    if package != "stringcast" or not parts or parts[0] not in CODE:
        return None
    place = ROOT.joinpath(*parts)
    return next((path for path in (place.with_suffix(".py"), place / "__init__.py") if path.is_file()), None)


def _short(file: Path) -> str:
    """The path from the project's folder; whole for an effect that lies elsewhere."""
    return file.relative_to(ROOT).as_posix() if file.is_relative_to(ROOT) else str(file)
