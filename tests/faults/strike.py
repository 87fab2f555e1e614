"""Let the n-th file operation of a small run fail.

The files left behind are checked, the run is continued, and its result is compared.
"""

import errno
import os
import shutil
from pathlib import Path
from types import SimpleNamespace

from stringcast.data import disk
from stringcast.data.schema import DataError
from tests.faults.toy import Killed, contents, toy_run

STEPS = {
    "motion": "generate",
    "trial": "execute",
    "points": "extract",
    "estimate": "estimate",
}


KINDS = {  # the fault, and whether it lasts until the run is restarted
    "kill": (Killed(), True),
    "disk full from then on": (OSError(errno.ENOSPC, "No space left on device"), True),
    "read-only from then on": (OSError(errno.EROFS, "Read-only file system"), True),
    "one operation fails": (OSError(errno.EIO, "Input/output error"), False),
}


class Faults:
    """A counter of file operations that lets the n-th fail.

    If the fault lasts, all later ones fail, too. A failing write writes half.
    """

    def __init__(self, patch, n, error, lasts):
        self.n, self.error, self.lasts, self.done = n, error, lasts, []
        for name in ("make_folder", "remove"):
            patch.setattr(disk, name, self.failing(name, getattr(disk, name)))
        system = {
            name: self.failing(name, getattr(os, name))
            for name in ("open", "fsync", "replace")
        }
        patch.setattr(disk, "os", SimpleNamespace(**{**vars(os), **system}))
        patch.setattr(disk, "open", self.opened, raising=False)

    @property
    def struck(self):
        """The operation that failed; None if there were fewer."""
        return self.done[self.n] if len(self.done) > self.n else None

    def failing(self, name, real):
        def operation(*given):
            self.count(name)
            return real(*given)

        return operation

    def count(self, name):
        """Count an operation, and raise if it is its turn."""
        self.done.append(name)
        at = len(self.done) - 1
        # a removal never raises an OSError
        harmless = name == "remove" and isinstance(self.error, OSError)
        if not harmless and (at == self.n or (self.lasts and at > self.n)):
            raise self.error

    def opened(self, path, mode):
        self.count("open a file")
        return File(open(path, mode), self)


class File:
    """A file whose writing may stop halfway."""

    def __init__(self, file, faults):
        self.file, self.faults = file, faults
        self.fileno, self.flush = file.fileno, file.flush

    def __enter__(self):
        return self

    def __exit__(self, *how):
        self.file.close()

    def write(self, content):
        try:
            self.faults.count("write")
        except BaseException:
            self.file.write(content[: len(content) // 2])
            raise
        self.file.write(content)


def strike(patch_context, n, kind, here, folder, whole):
    """Let the n-th operation fail and return it; None if there are fewer.

    Asserts that nothing is lost or incomplete. patch_context: monkeypatch.context.
    whole: contents of the uninterrupted run.
    """
    error, lasts = KINDS[kind]
    with patch_context() as patch:
        faults = Faults(patch, n, error, lasts)
        try:
            toy_run(folder, here)
        except (DataError, Killed) as raised:
            assert isinstance(raised, Killed) or error.strerror in str(raised)
    if faults.struck is not None:
        look_at_what_is_left(folder, whole)
        there = finished(folder)
        made, _ = toy_run(folder, here)
        assert sorted(there + made) == sorted(
            [*here.mode.stages] * here.config["max_casts"]
        ), "work was lost"
        assert contents(folder) == whole
        assert not find_litter(folder)
        shutil.rmtree(folder)
    return faults.struck


def find_litter(folder):
    """Return temporary files of interrupted writes."""
    return [*folder.rglob(".*.part"), *folder.rglob(".*.replaced")]


def finished(folder: Path):
    """Return the steps whose folder has its final name."""
    return [
        STEPS[p.name]
        for p in folder.glob("iterations/*/*")
        if not p.name.startswith(".")
    ]


def look_at_what_is_left(folder, whole):
    """Check the files of an interrupted run.

    Steps with final names are complete, files have their recorded content, and run.json
    exists only for a complete run.
    """
    left = contents(folder) if folder.exists() else {}
    left.pop("failed.txt", None)
    steps = {
        name: digest for name, digest in left.items() if name.startswith("iterations")
    }
    assert steps.items() <= whole.items(), steps.items() - whole.items()
    for place in {
        name.rsplit("/", 1)[0] for name in steps if name.endswith(".parquet")
    }:
        assert {n for n in steps if n.startswith(place)} == {
            n for n in whole if n.startswith(place)
        }
    if "run.json" in left:
        assert left == whole
