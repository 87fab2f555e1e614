"""Files of intermediate results, so that a killed step can continue.

Each is written atomically. Its name is a hash of the function and its arguments
(`stages.kept_results`), the code and the packages. The files are removed when the step
is stored.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stringcast.data import disk, store
from stringcast.data.file_checks import MAX_TABLE_BYTES
from stringcast.stages.kept_results import Arrays

NUMBER_TYPE = np.dtype("<f8")  # of results


@dataclass(frozen=True)
class KeptFiles:
    """Results in files of a folder.

    Parameters
    ----------
    folder : Path
        Folder of the files, next to that of the step.
    versions : mapping
        State of the code and of the packages.
    """

    folder: Path
    versions: Mapping[str, Any]

    def find(self, key: str) -> Arrays | None:
        """Return the result of a key; None if it is missing, damaged or too large."""
        path = self._path(key)
        if not path.is_file() or path.stat().st_size > MAX_TABLE_BYTES:
            return None
        header, _, numbers = path.read_bytes().partition(b"\n")
        try:
            stated = json.loads(header)
            shapes, digest = stated["shapes"], stated["sha256"]
            if digest != hashlib.sha256(numbers).hexdigest():
                return None
            ends = np.cumsum([math.prod(shape) for shape in shapes])
            parts = np.split(np.frombuffer(numbers, NUMBER_TYPE), ends)
            pairs = zip(parts[:-1], shapes, strict=True)
            return tuple(part.reshape(shape).copy() for part, shape in pairs)
        except (ValueError, TypeError, KeyError, RecursionError):
            return None

    def keep(self, key: str, result: Arrays) -> None:
        """Write a result; raise DataError if it cannot be written."""
        numbers = b"".join(array.astype(NUMBER_TYPE).tobytes() for array in result)
        digest = hashlib.sha256(numbers).hexdigest()
        header = {"shapes": [array.shape for array in result], "sha256": digest}
        store.write_bytes(
            self._path(key), json.dumps(header).encode() + b"\n" + numbers
        )

    def remove(self) -> None:
        """Remove all stored results of the step."""
        if self.folder.is_dir():
            disk.remove(self.folder)

    def _path(self, key: str) -> Path:
        text = json.dumps([key, self.versions], sort_keys=True)
        return self.folder / hashlib.sha256(text.encode()).hexdigest()
