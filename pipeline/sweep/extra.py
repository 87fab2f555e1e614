"""Packages that only some launchers need."""

from __future__ import annotations

import importlib
from types import ModuleType

from stringcast.pipeline.settings import UserError


def extra(package: str, launcher: str) -> ModuleType:
    """The package; raises UserError saying how to get it."""
    try:
        return importlib.import_module(package)
    except ImportError as error:
        remedy = f"Install it with .venv/bin/python -m pip install {package}"
        raise UserError(f"hydra/launcher={launcher}: the package {package} is missing ({error}). {remedy}.") from error
