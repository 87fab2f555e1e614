"""Who runs the jobs of a sweep, a file each, chosen by `hydra/launcher=`; their settings are in `conf/hydra/launcher`.

A launcher is a generator function: from attempts, which can be pickled and are called with a number of threads, it
yields the key of each when it has ended. What became of it stands in the ledger. Here is what several need.
"""

from __future__ import annotations

import importlib
import os
from types import ModuleType

from stringcast.pipeline.settings import UserError


def cores() -> int:
    """The number of cores that this process may use, where the system tells, else of all."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def extra(package: str, launcher: str) -> ModuleType:
    """The package; raises UserError saying how to get it."""
    try:
        return importlib.import_module(package)
    except ImportError as error:
        remedy = f"Install it with .venv/bin/python -m pip install {package}"
        raise UserError(f"hydra/launcher={launcher}: the package {package} is missing ({error}). {remedy}.") from error
