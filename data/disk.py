"""All file operations that write to disk.

They are in one module so that tests can make each one fail.
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
    """Write a new file and sync it to the disk."""
    with open(path, "xb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def sync_folder(path: Path) -> None:
    """Sync a folder's names to the disk.

    Only POSIX needs this; systems that cannot open folders sync by themselves.
    """
    if os.name != "posix":
        return
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def rename(source: Path, target: Path) -> None:
    """Rename a file or folder atomically, replacing a file of that name."""
    os.replace(source, target)


def remove(path: Path) -> None:
    """Remove a file or folder as far as possible; ignore a missing one."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
        return
    with suppress(OSError):
        path.unlink()


@contextmanager
def hold_lock(path: Path) -> Iterator[None]:
    """Hold a lock file inside the block.

    Raises BlockingIOError if another process holds it. The system releases the lock
    when the process ends or is killed; only the file stays.
    """
    with open(path, "a+b") as file:
        lock_file(file)
        if not path.exists() or not os.path.samestat(
            os.fstat(file.fileno()), path.stat()
        ):
            # removed by the previous holder
            raise BlockingIOError(f"{path} was removed by another process")
        yield


if sys.platform == "win32":

    def lock_file(file: IO[bytes]) -> None:
        """Lock an open file; raise BlockingIOError if another process holds it."""
        try:
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        except OSError as error:
            raise BlockingIOError(*error.args) from error
else:

    def lock_file(file: IO[bytes]) -> None:
        """Lock an open file; raise BlockingIOError if another process holds it."""
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
