"""Libraries that few commands need, imported at their first use."""

from __future__ import annotations

from importlib import import_module
from typing import Any


class LazyModule:
    """A module imported at its first use, such as `cv2 = LazyModule("cv2")`.

    It spares commands that do not need it: OpenCV takes 0.1 s to load, SciPy's
    rotations half a second.
    """

    def __init__(self, module: str) -> None:
        """Name the module to import."""
        self._module = module

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the module and keep it."""
        value = getattr(import_module(self._module), name)
        setattr(self, name, value)
        return value
