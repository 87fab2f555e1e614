"""Libraries that few commands need, loaded when something of them is first used."""

from __future__ import annotations

from importlib import import_module
from typing import Any


class LazyModule:
    """A module under another name, such as `cv2 = Later("cv2")`, where whoever imports
    the file may not need it: OpenCV takes 0.1 s to load, SciPy's rotations half a
    second.
    """

    def __init__(self, module: str) -> None:
        """module: its full name."""
        self._module = module

    def __getattr__(self, name: str) -> Any:
        """An attribute of the module, loaded and kept at its first use."""
        value = getattr(import_module(self._module), name)
        setattr(self, name, value)
        return value
