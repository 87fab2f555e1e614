"""Helpers of stages: progress, imports, names and scatter."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np

Progress = Callable[[float], object]  # called with the share of a stage that is done
MM_PER_M = 1e3  # [mm] in a metre
MS_PER_S = 1e3  # [ms] in a second
GRAVITY_M_S2 = 9.81
NORMAL_95 = 1.96  # half of a 95 % interval in standard deviations
# standard deviation over median magnitude, of a normal distribution
MAD_TO_SIGMA = 1.4826


@dataclass(frozen=True)
class SettingsGroup:
    """Settings that belong together.

    It is an argument of a stage's function. Its fields are settings of the stage's
    group, next to the others.
    """


def choose_evenly(total: int, count: int) -> np.ndarray:
    """Choose up to `count` of so many numbers evenly, the first and last among them."""
    return np.linspace(0, total - 1, min(count, total)).round().astype(int)


def import_file(name: str, path: Path) -> ModuleType:
    """Import a file under a name that is not a package's."""
    specification = importlib.util.spec_from_file_location(name, path)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    # where `inspect` looks for source text and Numba for its cached machine code
    sys.modules[name] = module
    specification.loader.exec_module(module)
    return module


class InterruptRequest(KeyboardInterrupt):
    """A request to end a stage, which may return what it has and say so."""


def partial_progress(progress: Progress, number: int, count: int) -> Progress:
    """Map the progress of one of `count` equally long parts to that of the whole."""
    return lambda share: progress((number + share) / count)


def readable_name(name: str) -> str:
    """Write the name of an effect or a parameter for people."""
    return name.replace("_", " ").replace(".", ": ")


def describe_causes(names: Sequence[str]) -> str:
    """Write the names of effects that act together for people."""
    return " and ".join(map(readable_name, names)) or "none"


def mad_sigma(values: np.ndarray) -> float:
    """Estimate the standard deviation about zero from the median magnitude.

    It is that of values of any shape, in their unit.
    """
    return MAD_TO_SIGMA * float(np.median(np.abs(values)))


def mean_square_over_trials(values: Iterable[np.ndarray]) -> float:
    """Compute the mean over trials of the mean square of each trial's values."""
    return float(np.mean([np.mean(trial_values**2) for trial_values in values]))


def rms(values: np.ndarray) -> float:
    """Compute the root mean square of values of any shape; NaN of none."""
    if not np.size(values):
        return np.nan
    return float(np.sqrt(np.mean(np.square(values))))
