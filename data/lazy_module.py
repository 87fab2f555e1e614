"""Libraries for few commands, imported at their first use."""

from __future__ import annotations

from functools import cached_property
from importlib import import_module
from types import ModuleType
from typing import Any

from stringcast.data.errors import ExpectedError

# libraries of extras by module name
EXTRAS = {
    "serial": ("pyserial", "lab"),
    "arviz": ("ArviZ", "arviz"),
    "mcap_ros2.writer": ("mcap-ros2-support", "mcap"),
    "mujoco": ("MuJoCo", "mujoco"),
}


class MissingPackageError(ExpectedError):
    """A library of an extra of this package is missing."""


def import_optional(module: str) -> ModuleType:
    """Import a library of an extra.

    Raises MissingPackageError if it is not installed; the message names the extra.
    """
    try:
        return import_module(module)
    except ImportError as error:
        name, extra = EXTRAS.get(module, (module, ""))
        if not extra:
            raise
        raise MissingPackageError(
            f"{name} is needed for this and cannot be imported ({error}). "
            f'Install it with pip install "stringcast[{extra}]".'
        ) from error


class LazyModule:
    """A module imported at its first use, such as `cv2 = LazyModule("cv2")`.

    OpenCV takes 0.1 s to load, SciPy's rotations half a second.
    """

    def __init__(self, module: str) -> None:
        """Name the module to import."""
        self._name = module

    @cached_property
    def _module(self) -> ModuleType:
        return import_optional(self._name)

    def import_now(self) -> None:
        """Import the module, so that forked workers need not."""
        self._module  # noqa: B018

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the module."""
        return getattr(self._module, name)
