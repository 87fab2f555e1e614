"""What the page of a stage is made from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from stringcast.stages.model.model import Model


@dataclass(frozen=True)
class Facts:
    """name: of the run. sentence: what came out. made: the stage's artifact. model: as configured. settings: by name.
    origin: seed, code, packages."""

    name: str
    sentence: str
    made: Any = field(repr=False)
    model: Model = field(repr=False)
    settings: Mapping[str, Any] = field(repr=False)
    origin: Mapping[str, Any] = field(repr=False)
