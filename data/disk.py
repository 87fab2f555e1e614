"""The few file operations by which everything is written, in one place so that tests
can make any of them fail.
"""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl


def make_folder(path: Path) -> None:
    """Make a folder, and those above it."""
    path.mkdir(parents=True, exist_ok=True)


def write(path: Path, content: bytes) -> None:
    """Write a new file and see it onto the disk."""
    with open(path, "xb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def sync_folder(path: Path) -> None:
    """See a folder's names onto the disk (POSIX; where folders cannot be opened, the
    system does so itself).
    """
    if os.name != "posix":
        return
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def rename(source: Path, target: Path) -> None:
    """Give a file or folder another name at once; a file of that name is replaced."""
    os.replace(source, target)


def remove(path: Path) -> None:
    """Remove a file or folder, if it is there, as far as that is possible."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
        return
    with suppress(OSError):
        path.unlink()


@contextmanager
def hold_lock(path: Path) -> Iterator[None]:
    """Hold a lock file; raises BlockingIOError where another process holds it.

    The system lets go of it when a process ends, however it ends: a dead one leaves no
    lock behind, only the file.
    """
    with open(path, "a+b") as file:
        _lock(file)
        if not path.exists() or not os.path.samestat(
            os.fstat(file.fileno()), path.stat()
        ):
            # which held it until now
            raise BlockingIOError(f"{path} was removed by another process")
        yield


if sys.platform == "win32":

    def _lock(file: IO[bytes]) -> None:
        try:
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        except OSError as error:
            raise BlockingIOError(*error.args) from error
else:

    def _lock(file: IO[bytes]) -> None:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
