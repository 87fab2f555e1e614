"""Registry of the stages, which finds them by itself.

A stage is a folder in `stages/` whose `__init__` defines STAGE.
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from stringcast import stages as package

if TYPE_CHECKING:
    from stringcast.stages.spec import StageSpec

STAGES_FOLDER = Path(package.__path__[0])


@cache
def stages() -> dict[str, StageSpec]:
    """Return all stages by name; raise ValueError for two of one name."""
    found = {}
    for file in sorted(STAGES_FOLDER.rglob("__init__.py")):
        if "\nSTAGE = " in file.read_text(encoding="utf-8"):
            folders = file.parent.relative_to(STAGES_FOLDER).parts
            stage: StageSpec = import_module(
                ".".join((package.__name__, *folders))
            ).STAGE
            if stage.name in found:
                raise ValueError(
                    f"{file}: there is already a stage {stage.name!r}. Rename this one."
                )
            found[stage.name] = stage
    return found
