"""Reference simulators that make synthetic datasets with hidden causes.

`draw("nodal", 7)` is the dataset of a seed: measurements, and their ground truth apart.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from dataclasses import replace
from functools import cache

from stringcast.data.schema import DataError
from tests.benchmarks.simulators.dataset import GroundTruth, SyntheticDataset, TrueCause
from tests.benchmarks.simulators.drawing import KINDS, Plan, draw_planned, kind_of
from tests.benchmarks.simulators.scene import Simulator

SIMULATORS = {  # modules of this folder, and their classes
    "own_kernel": ("own_kernel", "OwnKernel"),
    "nodal": ("nodal.simulator", "Nodal"),
    "pyelastica": ("pyelastica", "PyElastica"),
}


@cache
def load_simulator(name: str) -> Simulator:
    """Return the simulator of a name, or raise DataError if its package is missing."""
    module_name, class_name = SIMULATORS[name]
    try:
        module = importlib.import_module(f"{__name__}.{module_name}")
    except ModuleNotFoundError as missing:
        raise DataError(
            f"simulator {name}",
            f"it needs {missing.name}, which is not installed",
            f"pip install {name}",
        ) from None
    simulator: Simulator = getattr(module, class_name)()
    return simulator


def draw(
    simulator: str,
    seed: int,
    kind: str | None = None,
    causes: Sequence[str] | None = None,
    trials: int | None = None,
) -> SyntheticDataset:
    """Draw the dataset of a seed.

    Parameters
    ----------
    simulator : name of the simulator, of SIMULATORS
    seed : from which string, casts and causes are drawn
    kind : of KINDS, if not the seed's own
    causes : names of the causes to hide, if they are not drawn
    trials : their number, MIN_TRIALS or more, if it is not drawn

    Returns
    -------
    The dataset, the same for the same arguments and code.
    """
    if kind is None:
        kind = kind_of(seed)
    names = None if causes is None else tuple(causes)
    plan = Plan(simulator, load_simulator(simulator), seed, kind, names)
    if trials is not None:
        plan = replace(plan, trial_counts=(trials, trials))
    return draw_planned(plan)


__all__ = [
    "KINDS",
    "SIMULATORS",
    "GroundTruth",
    "SyntheticDataset",
    "TrueCause",
    "draw",
    "load_simulator",
]
