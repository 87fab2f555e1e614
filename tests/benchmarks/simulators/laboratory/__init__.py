"""Laboratories that are not the model: benches for the diagnosis, simulated in another
way and in other terms.

`bench("nodal", 7)` gives trials as a diagnosis takes them, and their ground truth. A
seed means the same bench for ever.
"""

from __future__ import annotations

import importlib
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from stringcast.data.artifacts import Observation
from stringcast.data.dataset import read_dataset
from stringcast.data.schema import DataError
from tests.benchmarks.simulators.laboratory.bench import LabBench, Truth
from tests.benchmarks.simulators.laboratory.drawing import draw
from tests.benchmarks.simulators.laboratory.scene import Laboratory

# modules of this folder, classes
LABORATORIES = {"nodal": "nodal:Nodal", "pyelastica": "elastica:Elastica"}


@cache
def laboratory(name: str) -> Laboratory:
    """The laboratory of that name. Raises DataError where it needs a package that is
    not here.
    """
    module, kind = LABORATORIES[name].split(":")
    try:
        made: Laboratory = getattr(
            importlib.import_module(f"{__name__}.{module}"), kind
        )()
    except ModuleNotFoundError as missing:
        raise DataError(
            f"laboratory={name} needs {missing.name}, which is not installed: pip install {name}"
        ) from None
    return made


def drawn(name: str, seed: int, kind: str | None = None) -> LabBench:
    """The bench of a seed. kind: none, single, pair, triple or outside, if it is not to
    be the seed's own.
    """
    return draw(name, laboratory(name), seed, kind)


def bench(
    name: str, seed: int, kind: str | None = None
) -> tuple[list[Observation], Truth]:
    """Trials of the bench of a seed, t00, t01 and so on in this order, and the ground
    truth.
    """
    made = drawn(name, seed, kind)
    with TemporaryDirectory() as folder:
        made.write(Path(folder))
        return list(read_dataset(Path(folder)).trials.values()), made.truth


__all__ = ["LABORATORIES", "LabBench", "Truth", "bench", "drawn", "laboratory"]
