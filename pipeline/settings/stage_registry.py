"""Registry of the stages.

A stage is a folder in `stages/`, of the package or of a plugin, whose `__init__`
defines STAGE. It is found automatically.
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from pathlib import Path
from types import UnionType

from stringcast import stages as package
from stringcast.pipeline.settings.composition import CONF_FOLDER
from stringcast.stages.plugins import (
    NAME_PATTERN,
    PluginError,
    import_plugin_module,
    plugin_files,
    plugin_folders,
)
from stringcast.stages.spec import Input, StageSpec

STAGES_FOLDER = Path(package.__path__[0])


def stages() -> dict[str, StageSpec]:
    """Return all stages by name.

    Raises PluginError for an unusable stage of a plugin, or a repeated name.
    """
    return _load_stages(tuple(plugin_folders().values()))


def refuse_wrong_description(stage: StageSpec, file: Path) -> None:
    """Raise PluginError for a plugin's stage with an attribute of a wrong type."""
    wanted = "a name of small letters, digits and _"
    faults = []
    for part in (stage.name, stage.folder):
        if not (isinstance(part, str) and NAME_PATTERN.fullmatch(part)):
            faults.append(f"{part!r} must be {wanted}")
    if not hasattr(stage.makes, "TABLES") or not isinstance(stage.makes, type):
        faults.append(f"makes = {stage.makes!r} must be a dataclass with TABLES")
    for name, taken in stage.inputs.items():
        kind = getattr(taken, "kind", None)
        if not isinstance(taken, Input) or not isinstance(kind, type | UnionType):
            faults.append(
                f"its input {name} must be a class in SameIteration, LatestIteration "
                "or CollectedTrials"
            )
    if faults:
        raise PluginError(file, faults[0], "Correct STAGE; see stages/README.md.")


@cache
def _load_stages(plugins: tuple[Path, ...]) -> dict[str, StageSpec]:
    """Load the stages of the package and of the plugins in these folders."""
    found: dict[str, StageSpec] = {}
    for file in sorted(STAGES_FOLDER.rglob("__init__.py")):
        if "\nSTAGE = " in file.read_text(encoding="utf-8"):
            folders = file.parent.relative_to(STAGES_FOLDER).parts
            stage = import_module(".".join((package.__name__, *folders))).STAGE
            found[stage.name] = stage

    artifact_folders = {stage.folder for stage in found.values()}
    for file, module in plugin_files("stages/*/__init__.py").items():
        stage = getattr(import_plugin_module(module), "STAGE", None)
        if not isinstance(stage, StageSpec):
            raise PluginError(
                file,
                "it must define STAGE, a StageSpec",
                "See stages/README.md.",
            )
        refuse_wrong_description(stage, file)
        if stage.name in found or stage.folder in artifact_folders:
            raise PluginError(
                file,
                f"there is already a stage {stage.name!r}, or one with the "
                f"folder {stage.folder!r}",
                "Rename this one.",
            )
        if (CONF_FOLDER / stage.name).is_dir():
            raise PluginError(
                file,
                f"the settings {stage.name!r} are of something else than this stage",
                "Rename the stage.",
            )
        found[stage.name] = stage
        artifact_folders.add(stage.folder)
    return found
