"""Modules of generated text, stored with their machine code in a cache folder.

A file is named after a hash of its text and of Numba, NumPy, Python and the processor.
Changed text is a new file, so stale machine code is never read.
"""

from __future__ import annotations

import getpass
import hashlib
import os
import stat
import sys
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path
from types import ModuleType

import llvmlite.binding
import numba
import numpy as np

from stringcast.stages.common import import_file

ROOT = Path(__file__).resolve().parents[3]


def import_generated_module(text: str) -> ModuleType:
    """Import a module of this text, from a file named after its content."""
    path = module_path(text)
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        unfinished = path.with_suffix(f".{os.getpid()}.tmp")
        unfinished.write_text(text, encoding="utf-8")
        os.replace(unfinished, path)
    return import_file(path.stem, path)


def module_path(text: str) -> Path:
    """Return the file of the module of this text.

    Its machine code lies in the same folder: STRINGCAST_CACHE, or one in the clone.
    """
    folder = Path(os.environ.get("STRINGCAST_CACHE") or ROOT / ".numba_cache")
    existing = folder if folder.exists() else folder.parent
    if not os.access(existing, os.W_OK):
        folder = private_temporary_folder()
    made_by = (
        f"{numba.__version__} {llvmlite.binding.get_host_cpu_name()} "
        f"{sys.version_info[:2]} {np.__version__}"
    )
    digest = hashlib.sha256((text + made_by).encode()).hexdigest()[:20]
    return folder / f"string_{digest}.py"


@cache
def private_temporary_folder() -> Path:
    """Return a temporary folder to which only this user can write code."""
    folder = Path(tempfile.gettempdir()) / f"stringcast-{getpass.getuser()}"
    with suppress(OSError):
        folder.mkdir(mode=0o700)
    if _is_private_folder(folder):
        return folder
    return Path(tempfile.mkdtemp(prefix="stringcast-"))


def _is_private_folder(folder: Path) -> bool:
    """Return whether this is a folder (not a link) that only this user may use."""
    try:
        status = folder.lstat()
    except OSError:
        return False
    if not stat.S_ISDIR(status.st_mode):
        return False
    # Windows has a temporary folder for each user and does not use modes.
    if not hasattr(os, "getuid"):
        return True
    return status.st_uid == os.getuid() and not status.st_mode & 0o077
