"""Modules of generated text: written to a cache folder, with their machine code, and
imported from there.

A file is named after a hash of its own text, of Numba, NumPy, Python and the processor:
changed text is a new file, and stale machine code cannot be read.
"""

from __future__ import annotations

import getpass
import hashlib
import importlib.util
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


def import_generated_module(text: str) -> ModuleType:
    """Import the module, written once to a cache folder under a name made of its
    content.
    """
    path = module_path(text)
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        aside = path.with_suffix(f".{os.getpid()}.tmp")
        aside.write_text(text, encoding="utf-8")
        os.replace(aside, path)
    specification = importlib.util.spec_from_file_location(path.stem, path)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    sys.modules[path.stem] = module  # cached machine code looks its module up by name
    specification.loader.exec_module(module)
    return module


def module_path(text: str) -> Path:
    """The file of the module of this text, beside its machine code, in the folder that
    STRINGCAST_CACHE names or in the clone's own.
    """
    chosen = os.environ.get("STRINGCAST_CACHE")
    folder = (
        Path(chosen) if chosen else Path(__file__).resolve().parents[3] / ".numba_cache"
    )
    usable = os.access(folder if folder.exists() else folder.parent, os.W_OK)
    made_by = f"{numba.__version__} {llvmlite.binding.get_host_cpu_name()} {sys.version_info[:2]} {np.__version__}"
    digest = hashlib.sha256((text + made_by).encode()).hexdigest()[:20]
    return (folder if usable else private_temporary_folder()) / f"string_{digest}.py"


@cache
def private_temporary_folder() -> Path:
    """A folder into which nobody else can have put code: others write where temporary
    files go, too.
    """
    folder = Path(tempfile.gettempdir()) / f"stringcast-{getpass.getuser()}"
    with suppress(OSError):
        folder.mkdir(mode=0o700)
    return (
        folder
        if _is_private_folder(folder)
        else Path(tempfile.mkdtemp(prefix="stringcast-"))
    )


def _is_private_folder(folder: Path) -> bool:
    """Whether it is a folder, no link to one, that belongs to this user and is open to
    nobody else.
    """
    try:
        about = folder.lstat()
    except OSError:
        return False
    # Windows has a temporary folder for each user, and modes that say nothing
    if not hasattr(os, "getuid"):
        return stat.S_ISDIR(about.st_mode)
    return (
        stat.S_ISDIR(about.st_mode)
        and about.st_uid == os.getuid()
        and not about.st_mode & 0o077
    )
