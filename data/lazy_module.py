"""Libraries for few commands, imported at their first use."""

from __future__ import annotations

from functools import cached_property
from importlib import import_module
from types import ModuleType
from typing import Any

from stringcast.data.errors import ExpectedError

# packages of the extras of this package, by the library that they install
OPTIONAL_PACKAGES = {
    "arviz": "arviz h5netcdf",
    "dynamixel_sdk": "dynamixel-sdk",
    "h5py": "h5py",
    "mcap": "mcap mcap-ros2-support",
    "mcap_ros2": "mcap mcap-ros2-support",
    "mujoco": "mujoco",
    "serial": "pyserial",
}


class MissingPackageError(ExpectedError):
    """An optional library is missing."""


class LazyModule:
    """A module imported at its first use, such as `cv2 = LazyModule("cv2")`.

    OpenCV takes 0.1 s to load, SciPy's rotations half a second. The first use of an
    optional library that is missing raises MissingPackageError.
    """

    def __init__(self, module: str) -> None:
        """Name the module to import."""
        self._name = module

    @cached_property
    def _module(self) -> ModuleType:
        try:
            return import_module(self._name)
        except ImportError as error:
            library = self._name.partition(".")[0]
            if library not in OPTIONAL_PACKAGES:
                raise
            raise MissingPackageError(
                "",
                f"{library} is needed for this and cannot be imported ({error})",
                f"Install it: pip install {OPTIONAL_PACKAGES[library]}",
            ) from error

    def import_now(self) -> None:
        """Import the module, so that forked workers need not."""
        self._module  # noqa: B018

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the module."""
        return getattr(self._module, name)
