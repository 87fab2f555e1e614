"""Registry of the stages, which finds them by itself.

A stage is a folder in `stages/`, of the package or of a plugin, whose `__init__`
defines STAGE.
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from stringcast import stages as package
from stringcast.stages.plugins import (
    PluginError,
    import_plugin_module,
    plugin_files,
    plugin_folders,
)

if TYPE_CHECKING:
    from stringcast.stages.spec import StageSpec

STAGES_FOLDER = Path(package.__path__[0])


def stages() -> dict[str, StageSpec]:
    """Return all stages by name.

    Raises
    ------
    PluginError
        For a plugin's stage that cannot be used, or has the name of another.
    """
    return _load_stages(tuple(plugin_folders().values()))


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
        if not isinstance(stage, type(found["estimate"])):
            raise PluginError(
                f"{file}: it must define STAGE, a StageSpec. See stages/README.md."
            )
        if stage.name in found or stage.folder in artifact_folders:
            raise PluginError(
                f"{file}: there is already a stage {stage.name!r}, or one with the "
                f"folder {stage.folder!r}. Rename this one."
            )
        found[stage.name] = stage
        artifact_folders.add(stage.folder)
    return found
