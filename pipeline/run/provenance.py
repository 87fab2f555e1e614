"""The origin of a stored step, and whether the step is stale.

The footer of a stored table holds settings, seed, inputs, code and packages. A step is
stale if the content of an input, a setting, the code or a package differs from its
footer. All code counts, by one digest, as the files used by a step are not known for
certain: a step that is stale without need costs only time. Dates do not count.
"""

from __future__ import annotations

import hashlib
import json
import platform
import subprocess
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from stringcast.data import store
from stringcast.data.schema import DataError
from stringcast.pipeline.run.file_names import artifact_folder
from stringcast.pipeline.run.iterations import Step
from stringcast.pipeline.run.stage_graph import INPUTS_SETTING, StageGraph
from stringcast.pipeline.settings.composition import (
    UserError,
    flatten_settings,
    setting_of,
)
from stringcast.pipeline.settings.stage_registry import stages
from stringcast.stages.plugins import PLUGIN_PREFIX, plugin_folders, plugin_sources

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
MAX_SOURCE_BYTES = 2**26  # [bytes]: of larger plugin files only the size counts
CODE_FOLDERS = ("data", "hardware", "pipeline", "stages")
REPEATABLE_LAB_PREFIX = "hardware.virtual."  # trials of the emulator never repeat
# required parts of an origin
PARTS_OF_ORIGIN = {"step", "seed", "inputs", "config", "code", "packages", "python"}
UNKNOWN_CODE = {"commit": "unknown", "source": "unknown"}
ABSENT_VALUE = "absent"
CODE_NAME = "the code"
HASHED_KINDS = ("input ", CODE_NAME)  # hash values, not shown


# --- origin of a step


def step_origin(
    config: Mapping[str, Any], step: str, seed: int, inputs: Mapping[str, str]
) -> dict[str, Any]:
    """Return the origin of a step: everything needed to make it again.

    config: all settings of the run. inputs: content hashes by path.
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


@cache  # reads a file each time
def package_version(name: str) -> str:
    """Return the version of a package; `absent` if not installed."""
    try:
        return version(name)
    except PackageNotFoundError:
        return "absent"


def code_state() -> dict[str, str]:
    """Return the commit, followed by + if sources have changed, and a source hash.

    The hash covers the sources of the package and of all plugins.
    """
    return code_state_with(tuple(plugin_folders().values()))


@cache
def code_state_with(plugins: tuple[Path, ...]) -> dict[str, str]:
    """Return the state of the code with the plugins in these folders."""
    sources = plugin_sources()
    for folder in CODE_FOLDERS:
        for file in (PROJECT_FOLDER / folder).rglob("*.py"):
            sources[file.relative_to(PROJECT_FOLDER).as_posix()] = file
    digest = hashlib.sha256()
    for name in sorted(sources):
        digest.update(name.encode() + b"\0" + source_content(sources[name]))
    commit = git_output("rev-parse", "HEAD").strip() or "unknown"
    changes = git_output("status", "--porcelain", "--", *CODE_FOLDERS)
    if any(line.endswith(".py") for line in changes.splitlines()):
        commit += "+"
    return {"commit": commit, "source": digest.hexdigest()}


def source_content(file: Path) -> bytes:
    """Return the content of a file of code, or the size of a large data file."""
    size = file.stat().st_size
    return file.read_bytes() if size <= MAX_SOURCE_BYTES else f"{size} bytes".encode()


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
    config: Mapping[str, Any],
    folder: Path,
    step: Step,
    hash_of: Callable[[Path], str] = store.content_hash,
) -> StoredStep:
    """Load a step from a run's folder, with the changes since it was made.

    config: all settings of the run. hash_of: returns the content hash of a folder.
    """
    step_folder = folder / step.folder
    if not step_folder.is_dir():
        return StoredStep(None, ("it has not been made yet",))
    try:
        artifact: Any = store.load(step.stage.makes, step_folder)
        damaged = store.damaged_image(step_folder)
    except (DataError, *store.READ_ERRORS) as error:
        return StoredStep(None, (str(error),))
    reasons = []
    if damaged:
        reasons.append(f"{damaged} is damaged")
    if getattr(artifact, "was_interrupted", False):
        reasons.append("it was interrupted")
    stored = store.read_origin(step_folder)
    current = current_origin(config, folder, step, hash_of)
    counting = [*step.stage.uses, f"{step.stage.name}.{INPUTS_SETTING}"]
    if step.stage.run.startswith(PLUGIN_PREFIX):
        counting.append("seed")  # every plugin stage gets the seed
    try:
        reasons += origin_changes(stored, current, counting)
    except KeyError as error:
        reasons.append(f"{error} is missing in what is said of its origin")
    return StoredStep(artifact, tuple(reasons))


def current_origin(
    config: Mapping[str, Any],
    folder: Path,
    step: Step,
    hash_of: Callable[[Path], str],
) -> dict[str, Any]:
    """Return the origin that a step would have if it were made now."""
    inputs = {}
    for path in step.input_folders:
        if (folder / path).is_dir():
            inputs[path.as_posix()] = hash_of(folder / path)
    inputs |= step.file_hashes
    seed = step.derive_seed(int(config["seed"]))
    return step_origin(config, step.stage.name, seed, inputs)


def stale_reasons(
    folder: Path, step_folder: Path, settings: Mapping[str, Any]
) -> tuple[str, ...]:
    """Return why a stored step of a run is stale, without building a model.

    `settings` are all settings of the run.
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
    """Return the content hashes of paths in the folders of a run and its trials.

    Other paths are left out. `trials` is the setting of the run.
    """
    allowed_folders = [folder.resolve()]
    if trials is not None:
        allowed_folders.append(Path(trials).resolve())
    hashes = {}
    hash_of = cache(store.content_hash)  # a footer may name a folder repeatedly
    for name in paths:
        path = folder / name if name.startswith("iterations/") else Path(name)
        path = path.resolve()
        is_allowed = any(path.is_relative_to(allowed) for allowed in allowed_folders)
        is_step = path.is_dir() and path.is_relative_to(allowed_folders[0])
        is_film = is_allowed and path.is_dir() and holds_frames_of(path, trials)
        if is_allowed and (is_step or is_film or path.is_file()):
            hashes[name] = hash_of(path)
    return hashes


def holds_frames_of(folder: Path, trials: str | None) -> bool:
    """Return whether a folder belongs to a dataset and has no subfolders.

    Foreign settings may name any folder; others must not be read.
    """
    if trials is None or not (Path(trials) / "dataset.yaml").is_file():
        return False
    return not any(path.is_dir() for path in folder.iterdir())


def origin_changes(
    stored: Mapping[str, Any], current: Mapping[str, Any], uses: Sequence[str]
) -> Iterator[str]:
    """Yield the differences of two origins, a line each, without hashes.

    uses: the settings to compare.
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
    """Return all parts of an origin that determine the artifact, by name."""
    values = {f"input {name}": digest for name, digest in origin["inputs"].items()}
    for name in uses:
        values |= flatten_settings(setting_of(origin["config"], name), name)
    values[CODE_NAME] = origin["code"]["source"]
    values |= {f"package {name}": v for name, v in origin["packages"].items()}
    return values | {"Python": origin["python"]}


def differing_values(
    first: Mapping[str, Any], second: Mapping[str, Any]
) -> list[tuple[str, Any, Any]]:
    """Return the differing values by name, with ABSENT_VALUE for missing ones."""
    differing = []
    for name in dict.fromkeys([*first, *second]):
        values = first.get(name, ABSENT_VALUE), second.get(name, ABSENT_VALUE)
        if values[0] != values[1]:
            differing.append((name, *values))
    return differing


def lab_is_repeatable(config: Mapping[str, Any]) -> bool:
    """Return whether arm and camera are simulated: trials repeat to the bit."""
    return str(config["hardware"]["_target_"]).startswith(REPEATABLE_LAB_PREFIX)


def arm_has_executed(
    config: Mapping[str, Any], folder: Path, number: int, stage: str, graph: StageGraph
) -> bool:
    """Return whether a real arm has executed a motion that depends on an artifact.

    Such artifacts are kept: those of stages before the movement of the iteration, and
    of all earlier iterations. `number` and `stage` are the iteration and the stage that
    made the artifact; `config` and `graph` are those of the run.
    """
    if lab_is_repeatable(config) or graph.movement is None:
        return False
    moved = number if graph.precedes_movement(stage) else number + 1
    return (folder / artifact_folder(moved, graph.movement)).is_dir()
