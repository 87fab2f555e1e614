"""A rod by absolute nodal coordinates, as compiled code that Numba keeps.

Importing any module of this room first removes machine code of changed sources.
"""

from __future__ import annotations

import hashlib
from pathlib import Path


def remove_stale_machine_code() -> None:
    """Remove cached machine code of this room if any of its sources has changed.

    Numba compares only the file of a function, not those that the function calls.
    """
    room = Path(__file__).resolve().parent
    sources = [*sorted(room.glob("*.py")), room.parent / "rod.py"]
    sources.append(room.parent / "pyelastica.py")
    digest = hashlib.sha256(b"".join(source.read_bytes() for source in sources))
    mark = room / "__pycache__" / f"sources-{digest.hexdigest()[:20]}"
    if mark.exists():
        return
    for folder in (room / "__pycache__", room.parent / "__pycache__"):
        folder.mkdir(exist_ok=True)
        for stale in [*folder.glob("*.nb[ci]"), *folder.glob("sources-*")]:
            stale.unlink(missing_ok=True)
    mark.touch()


remove_stale_machine_code()
