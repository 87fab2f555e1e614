"""A string, its trials and a camera: what a laboratory would measure, and how much of
it the plain string explains.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from stringcast.stages.model.arm import Arm
from stringcast.stages.model.camera import Camera
from tests.benchmarks.simulators.laboratory.hand import Hand, Path, path
from tests.benchmarks.simulators.laboratory.rod import Rod
from tests.benchmarks.simulators.laboratory.sight import Sight, seen

BASE = (
    *("axial", "axial_damping", "bending", "bending_damping"),
    *("linear_drag", "quadratic_drag", "grasp_stiffness", "grasp_damping"),
)
LITTLE = 0.01  # relative change of a base parameter, for slopes
# meshes and steps: to seek sizes with; to choose trials with, beside it; to state an
# error by; what is measured
ROUGH, LIKELY, CHECK, FINE = range(4)


class Moved(Protocol):
    """A string that was moved."""

    def points(self, times: np.ndarray, arc: np.ndarray) -> np.ndarray:
        """Positions (F, S, 2) [m] at times (F,) [s] and arc lengths (S,) [m]; NaN where
        it was lost.
        """


class Laboratory(Protocol):
    """Another way to simulate a rod. likely: how far apart ROUGH and LIKELY may have
    the tip in a trial that is chosen, for it is likely to be known well enough [m].
    """

    likely: float

    def moved(self, rod: Rod, path: Path, level: int) -> Moved:
        """The rod from rest, as the hand takes it along, as finely as ROUGH, LIKELY,
        CHECK or FINE say.
        """


@dataclass(frozen=True)
class Cast:
    """A motion as it was performed. t (K,), reported (K, J): times [s] and angles [rad]
    that the encoders logged. fine (M,), angles (M, J): those that the joints were
    driven through. frames: (F,) times of the camera's pictures [s].
    """

    t: np.ndarray
    reported: np.ndarray
    fine: np.ndarray
    angles: np.ndarray
    frames: np.ndarray


Values = Mapping[str, float]  # settings by name, beginning with rod., hand. or sight.


@dataclass(frozen=True)
class Scene:
    """A string, its casts and what measures them. rod: without any cause. s: (S,) arc
    lengths at which points are measured, the tip last [m]. sigma: noise in x and in y
    [m].
    """

    laboratory: Laboratory
    arm: Arm
    camera: Camera
    rod: Rod
    casts: tuple[Cast, ...]
    s: np.ndarray
    sigma: float

    def performing(self, casts: Sequence[Cast]) -> Scene:
        """This scene with other casts."""
        return replace(self, casts=tuple(casts))

    def path(self, cast: Cast, values: Values) -> Path:
        """The way of the grasp in a cast."""
        return path(
            self.arm, cast.fine, cast.angles, Hand()._replace(**_of("hand", values))
        )

    def seen(
        self, values: Values, level: int, only: int | None = None
    ) -> list[np.ndarray]:
        """Points as measured without noise in each cast, (F, S, 2) [m]. only: number of
        the cast in which `values` hold.
        """
        each = [
            values if only is None or number == only else {}
            for number in range(len(self.casts))
        ]
        return [
            self.measured(cast, own, level)
            for cast, own in zip(self.casts, each, strict=True)
        ]

    def measured(self, cast: Cast, values: Values, level: int) -> np.ndarray:
        """Points as measured without noise in a cast, (F, S, 2) [m]."""
        sight = Sight()._replace(**_of("sight", values))
        moved = self._moved(cast, values, level)
        arc = self.s * (1 + sight.misread)
        return seen(
            lambda times: moved.points(times, arc), cast.frames, self.camera, sight
        )

    def _moved(self, cast: Cast, values: Values, level: int) -> Moved:
        """The string moved. The rough mesh is cached: clocks and cameras change nothing
        about the string.
        """
        acting = tuple(
            sorted((n, v) for n, v in values.items() if not n.startswith("sight."))
        )
        key = (id(cast), acting)
        if level == ROUGH and key in self._rough:
            return self._rough[key]
        moved = self.laboratory.moved(
            self.rod._replace(**_of("rod", values)), self.path(cast, values), level
        )
        if level == ROUGH:
            self._rough[key] = moved
        return moved

    @cached_property
    def _rough(self) -> dict[tuple[int, tuple[tuple[str, float], ...]], Moved]:
        return {}

    @cached_property
    def slopes(self) -> np.ndarray:
        """Displacements by a small change of each base parameter, (P, N, S, 2) [m], in
        all frames of all casts.
        """
        plain = np.concatenate(self.seen({}, ROUGH))
        moved = [
            np.concatenate(
                self.seen(
                    {f"rod.{name}": getattr(self.rod, name) * (1 + LITTLE)}, ROUGH
                )
            )
            for name in BASE
        ]
        return np.stack(moved) - plain


def unexplained(field: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """A field (N, S, 2) less its projection on columns (P, N, S, 2)."""
    flat = columns.reshape(len(columns), -1).T
    scaled = flat / np.maximum(np.linalg.norm(flat, axis=0), 1e-30)
    return np.asarray(
        field
        - (scaled @ np.linalg.lstsq(scaled, field.ravel(), rcond=1e-8)[0]).reshape(
            field.shape
        )
    )


def at_tip(field: np.ndarray) -> float:
    """Root mean square of the tip's displacement [m]. field: (N, S, 2)."""
    return float(np.sqrt(np.mean(np.sum(field[:, -1] ** 2, axis=-1))))


def _of(world: str, values: Values) -> dict[str, float]:
    return {
        name.split(".")[1]: value
        for name, value in values.items()
        if name.startswith(f"{world}.")
    }
