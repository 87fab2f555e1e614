"""Causes outside the library, for benches whose cause must be called unknown."""

from __future__ import annotations

import importlib
from abc import abstractmethod
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from stringcast.stages.model.effect import Effect
from stringcast.stages.model.effect_plots import draw_line

if TYPE_CHECKING:
    from collections.abc import Mapping

    from matplotlib.axes import Axes


class Outside(Effect):
    """A cause outside the library. once: it acts in one trial only."""

    once: ClassVar[bool]
    reference = "None: made up to be unknown"

    @staticmethod
    @abstractmethod
    def circumstances(
        rng: np.random.Generator, t: np.ndarray, points: np.ndarray
    ) -> dict[str, float]:
        """All parameters but the size. t: (F,) [s], points: (F, n, 2) [m]: the string
        without it, where it acts.
        """

    @classmethod
    def plot(cls, axes: Axes, values: Mapping[str, float]) -> None:
        """No law to draw: how large it is, against its range."""
        size = cls.parameters[0]
        draw_line(
            axes,
            np.array([size.low, size.high]),
            np.full(2, values[size.name]),
            size.meaning,
            f"here / {size.unit}",
        )


def causes() -> tuple[type[Outside], ...]:
    """Every cause of this folder, by name."""
    files = sorted(
        path.stem
        for path in Path(__file__).parent.glob("*.py")
        if not path.name.startswith("_")
    )
    modules = [importlib.import_module(f"{__name__}.{stem}") for stem in files]
    return tuple(
        next(
            c
            for c in vars(module).values()
            if isinstance(c, type) and c.__module__ == module.__name__
        )
        for module in modules
    )


def moment(rng: np.random.Generator, t: np.ndarray) -> float:
    """A time well inside the trial, when the string moves [s]."""
    return float(rng.uniform(0.25, 0.6) * t[-1])


def place(
    rng: np.random.Generator, points: np.ndarray, first: float, last: float
) -> tuple[float, float]:
    """A random place (x, y) [m] where the outer third of the string comes by, between
    two shares of the trial's time. points: (F, S, 2) [m].
    """
    frame = int(rng.uniform(first, last) * len(points))
    x, y = points[frame, rng.integers(2 * points.shape[1] // 3, points.shape[1])]
    return float(x), float(y)


def direction(rng: np.random.Generator) -> float:
    """A random direction in the plane of motion [rad]."""
    return float(rng.uniform(-np.pi, np.pi))
