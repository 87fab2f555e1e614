"""Provenance: the origin of a stored step, and whether it would be made the same now.

A footer holds settings, seed, inputs, code and packages. Nothing asks a clock: a step
is stale if the content of an input, a setting, a source file or a package differs from
its footer. What has the same content is the same, whenever it was written.
"""

from __future__ import annotations

import ast
import hashlib
import json
import platform
import subprocess
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from stringcast.data import store
from stringcast.data.schema import DataError
from stringcast.pipeline.run.file_names import artifact_folder
from stringcast.pipeline.run.iterations import Step
from stringcast.pipeline.settings.composition import UserError, flatten_settings
from stringcast.pipeline.settings.stage_registry import stages
from stringcast.pipeline.settings.typed_settings import require_allowed
from stringcast.stages.model.library import effect_files, split_effect_name
from stringcast.stages.spec import StageSpec

PROJECT_FOLDER = Path(__file__).resolve().parents[2]
RECORDED_PACKAGES = (
    "numpy",
    "numba",
    "scipy",
    "opencv-python-headless",
    "pandas",
    "pyarrow",
    "hydra-core",
    "cmaes",
    "pydantic",
)
CODE_FOLDERS = ("data", "hardware", "pipeline", "stages")
# they hand every stage what it is given
SHARED_SOURCES = (
    "pipeline/run/iterations.py",
    "pipeline/run/experiment.py",
    "stages/spec.py",
)
# it imports every effect without naming any
EFFECT_LIBRARY_FILE = PROJECT_FOLDER / "stages" / "model" / "library.py"
MODEL_FILE = PROJECT_FOLDER / "stages" / "model" / "model.py"
VIRTUAL_LAB_PREFIX = "hardware.virtual."  # what it does can be done again, to the bit
ABSENT_VALUE = "absent"
# kinds of things of which an origin holds a hash, which tells people nothing
HASHED_KINDS = ("input ", "source ")


# --- what made a file
# -----------------------------------------------------------------------
def step_origin(
    config: Mapping[str, Any], step: str, seed: int, inputs: Mapping[str, str]
) -> dict[str, Any]:
    """The origin of a step: all that is needed to make it again. inputs: content hashes
    by path.
    """
    made = {
        "step": step,
        "seed": seed,
        "inputs": dict(inputs),
        "config": config,
        "python": platform.python_version(),
    }
    return made | software_versions()


def software_versions() -> dict[str, dict[str, str]]:
    """The state of this code, and the installed versions of the packages that decide
    about numbers, by name.
    """
    return {
        "code": code_state(),
        "packages": {name: package_version(name) for name in RECORDED_PACKAGES},
    }


package_version = cache(version)  # which reads a file each time


@cache
def code_state() -> dict[str, str]:
    """The commit, if known, with a + behind it where sources are no longer as it has
    them, and a hash of the source files as they are.
    """
    digest = hashlib.sha256()
    for file in sorted(
        p for folder in CODE_FOLDERS for p in (PROJECT_FOLDER / folder).rglob("*.py")
    ):
        digest.update(
            str(file.relative_to(PROJECT_FOLDER)).encode() + b"\0" + file.read_bytes()
        )
    asked = (("rev-parse", "HEAD"), ("status", "--porcelain", "--", *CODE_FOLDERS))
    commit, changed = (
        subprocess.run(
            ["git", *words],
            cwd=PROJECT_FOLDER,
            capture_output=True,
            text=True,
            check=False,
        ).stdout
        for words in asked
    )
    dirty = "+" * any(line.endswith(".py") for line in changed.splitlines())
    return {
        "commit": (commit.strip() or "unknown") + dirty,
        "source": digest.hexdigest(),
    }


# --- the sources behind a step
# --------------------------------------------------------------
def source_digests(settings: Mapping[str, Any], stage: StageSpec) -> dict[str, str]:
    """Digests of the files of a stage and of all that they import, however far.
    settings: those that it uses.
    """
    targets = {
        name: target
        for name, target in flatten_settings(settings).items()
        if name.endswith("._target_")
    }
    named = [
        require_allowed(target, name.removesuffix("._target_"), "config.json")
        for name, target in targets.items()
    ]
    roots = {file_of_target(name) for name in (*named, stage.run)} | (
        {MODEL_FILE} if "string" in settings else set()
    )
    roots |= {
        effect_files()[split_effect_name(name)[0]]
        for name in settings.get("effects", [])
    }
    behind = imported_files(roots) | {PROJECT_FOLDER / name for name in SHARED_SOURCES}
    return {relative_name(file): parse_source(file)[1] for file in sorted(behind)}


def file_of_target(target: str) -> Path:
    """The file in which a `_target_` of ours is defined, without loading it, which
    takes seconds: that of the module it is in, or of its own name, from where a package
    has it.
    """
    file = module_file(f"stringcast.{target}") or module_file(
        f"stringcast.{target.rpartition('.')[0]}"
    )
    assert file is not None, f"{target} lies in no file of ours"
    return file


def imported_files(roots: Iterable[Path]) -> set[Path]:
    """Files, and all of ours that they import."""
    found: set[Path] = set()
    ahead = list(roots)
    while ahead:
        file = ahead.pop()
        if file not in found:
            found.add(file)
            ahead += (
                () if relative_name(file) in SHARED_SOURCES else parse_source(file)[0]
            )
            ahead += effect_files().values() if file == EFFECT_LIBRARY_FILE else ()
    return found


@cache
def parse_source(file: Path) -> tuple[tuple[Path, ...], str]:
    """The files of ours that a file imports, wherever in it, and a digest of what
    Python runs of it: comments, line breaks and docstrings make no step stale. Of one
    tree, for it takes as long to parse as all else.

    A new name or place does: a step called stale without need costs the time to make it
    again, to the same bits; one called fresh without need, as where two functions swap
    their names, costs the trust in all of them.
    """
    tree = ast.parse(file.read_text(encoding="utf-8"))
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {
                node.module,
                *(f"{node.module}.{alias.name}" for alias in node.names),
            }
        elif isinstance(
            node, ast.Module | ast.ClassDef | ast.FunctionDef
        ) and ast.get_docstring(node, clean=False):
            del node.body[0]
    packages = {
        ".".join(name.split(".")[:end])
        for name in names
        for end in range(1, name.count(".") + 2)
    }
    imported = tuple(
        path for name in sorted(packages) if (path := module_file(name)) is not None
    )
    return imported, hashlib.sha256(ast.dump(tree).encode()).hexdigest()[:16]


def module_file(module: str) -> Path | None:
    """The file of a module of ours; None for others'."""
    package, *parts = module.split(".")
    if package != "stringcast" or not parts or parts[0] not in CODE_FOLDERS:
        return None
    place = PROJECT_FOLDER.joinpath(*parts)
    return next(
        (
            path
            for path in (place.with_suffix(".py"), place / "__init__.py")
            if path.is_file()
        ),
        None,
    )


def relative_name(file: Path) -> str:
    """The path from the project's folder; whole for an effect that lies elsewhere."""
    return (
        file.relative_to(PROJECT_FOLDER).as_posix()
        if file.is_relative_to(PROJECT_FOLDER)
        else str(file)
    )


# --- fresh or stale
# ---------------------------------------------------------------------------
@dataclass(frozen=True)
class StoredStep:
    """A step on the disk. artifact: None where there is none that can be read. reasons:
    why it is stale; empty if it is fresh.
    """

    artifact: Any
    stale_reasons: tuple[str, ...] = ()


def load_step_with_staleness(
    config: Mapping[str, Any], folder: Path, step: Step
) -> StoredStep:
    """A step in a run's folder, with all that has changed since it was made. config:
    the run's settings.
    """
    place = folder / step.folder
    if not place.is_dir():
        return StoredStep(None, ("it has not been made yet",))
    try:
        artifact: Any = store.load(step.stage.makes, place)
    except DataError as error:
        return StoredStep(None, (str(error),))
    made = store.read_origin(place)
    early = ("it was interrupted",) if getattr(artifact, "interrupted", False) else ()
    return StoredStep(
        artifact,
        (
            *early,
            *origin_changes(
                made, current_origin(config, folder, step), step.stage.uses
            ),
        ),
    )


def current_origin(
    config: Mapping[str, Any], folder: Path, step: Step
) -> dict[str, Any]:
    """The origin that a step would have if it were made now, of inputs in the run's
    folder and of stored ones.
    """
    used = {key: config[key] for key in step.stage.uses}
    there = [place for place in step.input_folders if (folder / place).is_dir()]
    inputs = {
        place.as_posix(): store.content_hash(folder / place) for place in there
    } | dict(step.file_hashes)
    made = step_origin(
        config, step.stage.name, step.derive_seed(int(config["seed"])), inputs
    )
    return made | {"sources": source_digests(used, step.stage)}


def stale_reasons(
    folder: Path, place: Path, settings: Mapping[str, Any]
) -> tuple[str, ...]:
    """The reasons why a stored step would be made again, by its files and the run's
    settings alone: no model is built of these.
    """
    try:
        made = store.read_origin(place)
        inputs = input_hashes(folder, made["inputs"], settings["trials"])
        return load_step_with_staleness(
            settings,
            folder,
            Step(
                stages()[made["step"]], int(place.parent.name), {}, file_hashes=inputs
            ),
        ).stale_reasons
    except KeyError as error:
        return (
            f"it or the settings lack {error}: another version of this code made the run",
        )
    except (DataError, UserError, *store.READ_ERRORS) as error:
        return (str(error),)


def input_hashes(
    folder: Path, paths: Mapping[str, str], trials: str | None
) -> dict[str, str]:
    """Content hashes of those of the paths that lie in the run's folder, or in that of
    its stored trials, which begin as `trials` does.
    """
    homes = [Path(home).resolve() for home in (folder, trials) if home is not None]
    places = {
        path: (
            folder / path if path.startswith("iterations/") else Path(path)
        ).resolve()
        for path in paths
    }
    known = {
        path: place
        for path, place in places.items()
        if any(place.is_relative_to(home) for home in homes)
    }
    return {
        path: store.content_hash(place)
        for path, place in known.items()
        if place.is_dir() or place.is_file()
    }


def origin_changes(
    made: Mapping[str, Any], now: Mapping[str, Any], uses: Sequence[str]
) -> Iterator[str]:
    """Differences of two origins, a line each, without the hashes. uses: the settings
    that count.
    """
    decisive = []  # all of either that decides what comes out, by name
    for one in (made, json.loads(json.dumps(now))):  # as stored: JSON knows no tuples
        inputs, sources, packages = (
            {f"{kind} {name}": value for name, value in one[f"{kind}s"].items()}
            for kind in ("input", "source", "package")
        )
        settings = flatten_settings({key: one["config"].get(key) for key in uses})
        decisive.append(
            inputs | settings | sources | packages | {"Python": one["python"]}
        )
    for name, before, after in differing_values(*decisive):
        became = (
            "is new"
            if before == ABSENT_VALUE
            else "is gone"
            if after == ABSENT_VALUE
            else "has changed"
        )
        yield (
            f"{name} {became}"
            if name.startswith(HASHED_KINDS)
            else f"{name} {before} -> {after}"
        )


def differing_values(
    a: Mapping[str, Any], b: Mapping[str, Any]
) -> list[tuple[str, Any, Any]]:
    """Names whose values differ, with both values; ABSENT where there is none."""
    both = [
        (name, a.get(name, ABSENT_VALUE), b.get(name, ABSENT_VALUE))
        for name in dict.fromkeys([*a, *b])
    ]
    return [(name, one, other) for name, one, other in both if one != other]


def is_repeatable(config: Mapping[str, Any], artifact: str) -> bool:
    """Whether an artifact can be made again: all but what a real arm and camera did."""
    return artifact != "trial" or str(config["hardware"]["_target_"]).startswith(
        VIRTUAL_LAB_PREFIX
    )


def arm_has_executed(
    config: Mapping[str, Any], folder: Path, number: int, artifact: str
) -> bool:
    """Whether a real arm has moved by an artifact of an iteration: then it stays, for
    what was measured hangs on it.
    """
    nearest = number if artifact in ("motion", "trial") else number + 1
    return (
        not is_repeatable(config, "trial")
        and (folder / artifact_folder(nearest, "trial")).is_dir()
    )
