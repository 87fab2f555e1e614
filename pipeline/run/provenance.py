"""The origin of a stored step, and whether it would be made the same now.

The footer of a stored table holds settings, seed, inputs, code and packages. A step is
stale if the content of an input, a setting, a source file or a package differs from its
footer. Dates do not count.
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
SHARED_SOURCES = (  # used by every stage; their imports do not count
    "pipeline/run/iterations.py",
    "pipeline/run/experiment.py",
    "stages/spec.py",
)
# imports every effect without naming any
EFFECT_LIBRARY_FILE = PROJECT_FOLDER / "stages" / "model" / "library.py"
MODEL_FILE = PROJECT_FOLDER / "stages" / "model" / "model.py"
VIRTUAL_LAB_PREFIX = "hardware.virtual."  # its trials can be repeated bit by bit
ABSENT_VALUE = "absent"
HASHED_KINDS = ("input ", "source ")  # their values are hashes, which are not shown


# --- origin of a step


def step_origin(
    config: Mapping[str, Any], step: str, seed: int, inputs: Mapping[str, str]
) -> dict[str, Any]:
    """Return the origin of a step: all that is needed to make it again.

    Parameters
    ----------
    config : mapping
        All settings of the run.
    step : str
        Name of the stage.
    seed : int
        Seed of the step.
    inputs : mapping
        Content hashes by path.
    """
    origin = {
        "step": step,
        "seed": seed,
        "inputs": dict(inputs),
        "config": config,
        "python": platform.python_version(),
    }
    return origin | software_versions()


def software_versions() -> dict[str, dict[str, str]]:
    """Return the state of this code and the versions of the recorded packages."""
    packages = {name: package_version(name) for name in RECORDED_PACKAGES}
    return {"code": code_state(), "packages": packages}


package_version = cache(version)  # reads a file each time


@cache
def code_state() -> dict[str, str]:
    """Return the commit, followed by + if sources have changed, and a source hash."""
    digest = hashlib.sha256()
    files = [p for name in CODE_FOLDERS for p in (PROJECT_FOLDER / name).rglob("*.py")]
    for file in sorted(files):
        name = str(file.relative_to(PROJECT_FOLDER))
        digest.update(name.encode() + b"\0" + file.read_bytes())
    commit = git_output("rev-parse", "HEAD").strip() or "unknown"
    changes = git_output("status", "--porcelain", "--", *CODE_FOLDERS)
    if any(line.endswith(".py") for line in changes.splitlines()):
        commit += "+"
    return {"commit": commit, "source": digest.hexdigest()}


def git_output(*arguments: str) -> str:
    """Return the output of git in the project's folder; empty if it fails."""
    process = subprocess.run(
        ["git", *arguments],
        cwd=PROJECT_FOLDER,
        capture_output=True,
        text=True,
        check=False,
    )
    return process.stdout


# --- sources of a step


def source_digests(settings: Mapping[str, Any], stage: StageSpec) -> dict[str, str]:
    """Return digests of a stage's sources and of all that they import.

    Parameters
    ----------
    settings : mapping
        Settings that the stage uses.
    stage : StageSpec
        The stage.

    Returns
    -------
    dict
        Digests by path from the project's folder.
    """
    roots = {file_of_target(stage.run)}
    for name, target in flatten_settings(settings).items():
        if name.endswith("._target_"):
            place = name.removesuffix("._target_")
            roots.add(file_of_target(require_allowed(target, place, "config.json")))
    if "string" in settings:
        roots.add(MODEL_FILE)
    for name in settings.get("effects", []):
        roots.add(effect_files()[split_effect_name(name)[0]])
    files = imported_files(roots) | {PROJECT_FOLDER / name for name in SHARED_SOURCES}
    return {relative_name(file): parse_source(file)[1] for file in sorted(files)}


def file_of_target(target: str) -> Path:
    """Return the file that defines a `_target_` of this package, without loading it.

    It is the file of the module of this name, or of the module around it.
    """
    module = target.rpartition(".")[0]
    file = module_file(f"stringcast.{target}") or module_file(f"stringcast.{module}")
    assert file is not None, f"{target} is in no file of this package"
    return file


def imported_files(roots: Iterable[Path]) -> set[Path]:
    """Return these files and all files of this package that they import."""
    files: set[Path] = set()
    waiting = list(roots)
    while waiting:
        file = waiting.pop()
        if file in files:
            continue
        files.add(file)
        if relative_name(file) not in SHARED_SOURCES:
            waiting += parse_source(file)[0]
        if file == EFFECT_LIBRARY_FILE:
            waiting += effect_files().values()
    return files


@cache
def parse_source(file: Path) -> tuple[tuple[Path, ...], str]:
    """Return the files of this package that a file imports, and a digest of its code.

    Comments, line breaks and docstrings do not change the digest; names do. A step that
    is needlessly stale costs time; one that is wrongly fresh, as after two functions
    swapped names, costs trust.
    """
    tree = ast.parse(file.read_text(encoding="utf-8"))
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.add(node.module)
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            if ast.get_docstring(node, clean=False):
                del node.body[0]

    modules = set()  # with the packages around each
    for name in names:
        parts = name.split(".")
        modules |= {".".join(parts[:end]) for end in range(1, len(parts) + 1)}
    files = [module_file(module) for module in sorted(modules)]
    digest = hashlib.sha256(ast.dump(tree).encode()).hexdigest()[:16]
    return tuple(file for file in files if file is not None), digest


def module_file(module: str) -> Path | None:
    """Return the file of a module of this package; None for other modules."""
    package, *parts = module.split(".")
    if package != "stringcast" or not parts or parts[0] not in CODE_FOLDERS:
        return None
    path = PROJECT_FOLDER.joinpath(*parts)
    for file in (path.with_suffix(".py"), path / "__init__.py"):
        if file.is_file():
            return file
    return None


def relative_name(file: Path) -> str:
    """Return the path from the project's folder; whole for an effect elsewhere."""
    if file.is_relative_to(PROJECT_FOLDER):
        return file.relative_to(PROJECT_FOLDER).as_posix()
    return str(file)


# --- fresh or stale


@dataclass(frozen=True)
class StoredStep:
    """A step as it is stored.

    Parameters
    ----------
    artifact : object
        The artifact; None if there is none that can be read.
    stale_reasons : tuple of str
        Why it is stale; empty if it is fresh.
    """

    artifact: Any
    stale_reasons: tuple[str, ...] = ()


def load_step_with_staleness(
    config: Mapping[str, Any], folder: Path, step: Step
) -> StoredStep:
    """Load a step from a run's folder, with all that has changed since it was made.

    Parameters
    ----------
    config : mapping
        All settings of the run.
    folder : Path
        Folder of the run.
    step : Step
        The step to look for.
    """
    step_folder = folder / step.folder
    if not step_folder.is_dir():
        return StoredStep(None, ("it has not been made yet",))
    try:
        artifact: Any = store.load(step.stage.makes, step_folder)
    except DataError as error:
        return StoredStep(None, (str(error),))
    reasons = []
    if getattr(artifact, "was_interrupted", False):
        reasons.append("it was interrupted")
    stored, current = (
        store.read_origin(step_folder),
        current_origin(config, folder, step),
    )
    reasons += origin_changes(stored, current, step.stage.uses)
    return StoredStep(artifact, tuple(reasons))


def current_origin(
    config: Mapping[str, Any], folder: Path, step: Step
) -> dict[str, Any]:
    """Return the origin that a step would have if it were made now."""
    inputs = {}
    for path in step.input_folders:
        if (folder / path).is_dir():
            inputs[path.as_posix()] = store.content_hash(folder / path)
    inputs |= step.file_hashes
    seed = step.derive_seed(int(config["seed"]))
    origin = step_origin(config, step.stage.name, seed, inputs)
    used_settings = {name: config[name] for name in step.stage.uses}
    origin["sources"] = source_digests(used_settings, step.stage)
    return origin


def stale_reasons(
    folder: Path, step_folder: Path, settings: Mapping[str, Any]
) -> tuple[str, ...]:
    """Return why a stored step would be made again, without building a model.

    Parameters
    ----------
    folder, step_folder : Path
        Folders of the run and of the step.
    settings : mapping
        All settings of the run.
    """
    try:
        origin = store.read_origin(step_folder)
        hashes = input_hashes(folder, origin["inputs"], settings["trials"])
        number = int(step_folder.parent.name)
        step = Step(stages()[origin["step"]], number, {}, file_hashes=hashes)
        return load_step_with_staleness(settings, folder, step).stale_reasons
    except KeyError as error:
        return (f"{error} is missing in the step or in the settings",)
    except (DataError, UserError, *store.READ_ERRORS) as error:
        return (str(error),)


def input_hashes(
    folder: Path, paths: Iterable[str], trials: str | None
) -> dict[str, str]:
    """Return the content hashes of paths in a run's folder or in that of its trials.

    Parameters
    ----------
    folder : Path
        Folder of the run.
    paths : iterable of str
        Paths of inputs; other paths are left out.
    trials : str or None
        Setting `trials` of the run.
    """
    allowed_folders = [folder.resolve()]
    if trials is not None:
        allowed_folders.append(Path(trials).resolve())
    hashes = {}
    for name in paths:
        path = folder / name if name.startswith("iterations/") else Path(name)
        path = path.resolve()
        is_allowed = any(path.is_relative_to(allowed) for allowed in allowed_folders)
        if is_allowed and (path.is_dir() or path.is_file()):
            hashes[name] = store.content_hash(path)
    return hashes


def origin_changes(
    stored: Mapping[str, Any], current: Mapping[str, Any], uses: Sequence[str]
) -> Iterator[str]:
    """Yield the differences of two origins, a line each, without the hashes.

    Parameters
    ----------
    stored, current : mapping
        Origins of a step.
    uses : sequence of str
        Settings that count.
    """
    as_stored = json.loads(json.dumps(current))  # JSON has no tuples
    before_and_after = decisive_values(stored, uses), decisive_values(as_stored, uses)
    for name, before, after in differing_values(*before_and_after):
        if not name.startswith(HASHED_KINDS):
            yield f"{name} {before} -> {after}"
        elif before == ABSENT_VALUE:
            yield f"{name} is new"
        elif after == ABSENT_VALUE:
            yield f"{name} is gone"
        else:
            yield f"{name} has changed"


def decisive_values(origin: Mapping[str, Any], uses: Sequence[str]) -> dict[str, Any]:
    """Return all parts of an origin that decide about the artifact, by name."""
    values = {f"input {name}": digest for name, digest in origin["inputs"].items()}
    values |= flatten_settings({name: origin["config"].get(name) for name in uses})
    values |= {f"source {name}": digest for name, digest in origin["sources"].items()}
    values |= {f"package {name}": v for name, v in origin["packages"].items()}
    return values | {"Python": origin["python"]}


def differing_values(
    first: Mapping[str, Any], second: Mapping[str, Any]
) -> list[tuple[str, Any, Any]]:
    """Return the names whose values differ with both values, or ABSENT_VALUE."""
    differing = []
    for name in dict.fromkeys([*first, *second]):
        values = first.get(name, ABSENT_VALUE), second.get(name, ABSENT_VALUE)
        if values[0] != values[1]:
            differing.append((name, *values))
    return differing


def is_repeatable(config: Mapping[str, Any], artifact: str) -> bool:
    """Tell whether an artifact can be made again, unlike the trial of a real arm."""
    is_virtual = str(config["hardware"]["_target_"]).startswith(VIRTUAL_LAB_PREFIX)
    return is_virtual or artifact != "trial"


def arm_has_executed(
    config: Mapping[str, Any], folder: Path, number: int, artifact: str
) -> bool:
    """Tell whether a real arm has moved by an artifact of an iteration.

    Such an artifact is kept, for measurements depend on it.
    """
    if is_repeatable(config, "trial"):
        return False
    trial_number = number if artifact in ("motion", "trial") else number + 1
    return (folder / artifact_folder(trial_number, "trial")).is_dir()
