"""A string, its casts and a camera: what a reference simulator would measure."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum, auto
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, Protocol, TypeVar

import numpy as np

from stringcast.stages.model.arm import Arm
from stringcast.stages.model.camera import Camera
from tests.benchmarks.simulators.camera_faults import CameraFaults, report_points
from tests.benchmarks.simulators.causes import Cause
from tests.benchmarks.simulators.hand import GraspPath, HandFaults, grasp_path
from tests.benchmarks.simulators.motions import Cast
from tests.benchmarks.simulators.rod import BASE_FIELDS, Rod

BASE_STEP = 0.01  # relative change of a base parameter, for slopes
Settings = Mapping[str, float]  # by name, such as rod.tip_mass
Record = TypeVar("Record", bound=NamedTuple)


class Fidelity(Enum):
    """Meshes and steps, from coarse to fine.

    SEARCH serves sizes of causes. SCREENING, with SEARCH, serves the choice of casts.
    CHECK serves the numerical error of FINAL, with which measurements are made.
    """

    SEARCH = auto()
    SCREENING = auto()
    CHECK = auto()
    FINAL = auto()


class StringMotion(Protocol):
    """A simulated motion of a string."""

    def points(self, times: np.ndarray, arc: np.ndarray) -> np.ndarray:
        """Return positions (F, S, 2) [m] at times (F,) [s] and arc lengths (S,) [m].

        They are NaN where the simulation diverged.
        """


class Simulator(ABC):
    """A way to simulate a string, and the causes that it can hide.

    `screening_tolerance` is the largest distance [m] of the tip between SEARCH and
    SCREENING in a cast that is chosen. Such casts are likely to be simulated
    accurately.
    """

    screening_tolerance: ClassVar[float]

    @property
    @abstractmethod
    def causes(self) -> tuple[Cause, ...]:
        """The causes that may be hidden, in order."""

    @property
    def outside_causes_of_mixtures(self) -> tuple[Cause, ...]:
        """The causes outside the library that can be hidden beside one of it."""
        return tuple(cause for cause in self.causes if cause.outside)

    @abstractmethod
    def move(self, rod: Rod, path: GraspPath, fidelity: Fidelity) -> StringMotion:
        """Simulate a rod that starts from rest and follows the grasp."""

    def observe(
        self, scene: Scene, cast: Cast, settings: Settings, fidelity: Fidelity
    ) -> np.ndarray:
        """Return the points that are reported of a cast without noise.

        Parameters
        ----------
        scene : string, arm and camera
        cast : the motion
        settings : of the causes
        fidelity : of the simulation

        Returns
        -------
        Positions (F, S, 2) [m].
        """
        faults = with_settings(CameraFaults(), "camera", settings)
        motion = scene.string_motion(cast, settings, fidelity)
        arc = scene.s * (1 + faults.length_error)
        return report_points(
            lambda times: motion.points(times, arc), cast.frames, scene.camera, faults
        )


@dataclass(frozen=True)
class Scene:
    """A string, its casts and what measures them.

    Parameters
    ----------
    simulator : of the string
    arm : the arm
    camera : the camera
    rod : the string without any cause
    casts : the motions
    s : (S,) arc lengths at which points are measured, the tip last [m]
    sigma : noise in x and in y [m]
    """

    simulator: Simulator
    arm: Arm
    camera: Camera
    rod: Rod
    casts: tuple[Cast, ...]
    s: np.ndarray
    sigma: float
    _motions: dict[Any, StringMotion] = field(
        default_factory=dict, repr=False, compare=False
    )

    def with_casts(self, casts: Sequence[Cast]) -> Scene:
        """Return this scene with other casts."""
        return replace(self, casts=tuple(casts))

    def grasp_path(self, cast: Cast, settings: Settings) -> GraspPath:
        """Return the path of the grasp in a cast."""
        faults = with_settings(HandFaults(), "hand", settings)
        return grasp_path(self.arm, cast.fine, cast.angles, faults)

    def observe(self, cast: Cast, settings: Settings, fidelity: Fidelity) -> np.ndarray:
        """Return the points of a cast without noise, (F, S, 2) [m]."""
        return self.simulator.observe(self, cast, settings, fidelity)

    def observe_all(
        self, settings: Settings, fidelity: Fidelity, only_cast: int | None = None
    ) -> np.ndarray:
        """Return the points of all frames of all casts without noise, (N, S, 2) [m].

        `only_cast` is the number of the one cast in which the settings hold, if not in
        all.
        """
        fields = []
        for number, cast in enumerate(self.casts):
            active = only_cast is None or number == only_cast
            fields.append(self.observe(cast, settings if active else {}, fidelity))
        return np.concatenate(fields)

    def string_motion(
        self, cast: Cast, settings: Settings, fidelity: Fidelity
    ) -> StringMotion:
        """Return the motion of the string in a cast.

        Motions for the search are kept: clocks and cameras do not change them.
        """
        changes = [
            item for item in settings.items() if not item[0].startswith("camera.")
        ]
        key = (cast, tuple(sorted(changes)))
        if fidelity is Fidelity.SEARCH and key in self._motions:
            return self._motions[key]
        rod = with_settings(self.rod, "rod", settings)
        motion = self.simulator.move(rod, self.grasp_path(cast, settings), fidelity)
        if fidelity is Fidelity.SEARCH:
            self._motions[key] = motion
        return motion

    @cached_property
    def base_slopes(self) -> np.ndarray:
        """Return displacements by a small change of each base parameter.

        They have shape (P, N, S, 2) [m].
        """
        plain = self.observe_all({}, Fidelity.SEARCH)
        slopes = []
        for name in BASE_FIELDS:
            changed = getattr(self.rod, name) * (1 + BASE_STEP)
            moved = self.observe_all({f"rod.{name}": changed}, Fidelity.SEARCH)
            slopes.append(moved - plain)
        return np.stack(slopes)


def with_settings(record: Record, prefix: str, settings: Settings) -> Record:
    """Return a record with the settings whose names begin with a prefix."""
    changes = {}
    for name, value in settings.items():
        world, _, field_name = name.partition(".")
        if world == prefix:
            changes[field_name] = value
    changed: Record = record._replace(**changes)
    return changed


def remove_projection(field_m: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Subtract from a field (N, S, 2) its projection on columns (P, N, S, 2)."""
    flat = columns.reshape(len(columns), -1).T
    scaled = flat / np.maximum(np.linalg.norm(flat, axis=0), 1e-30)
    weights = np.linalg.lstsq(scaled, field_m.ravel(), rcond=1e-8)[0]
    return np.asarray(field_m - (scaled @ weights).reshape(field_m.shape))


def tip_rms(field_m: np.ndarray) -> float:
    """Return the root mean square displacement of the tip of a field (N, S, 2) [m]."""
    return float(np.sqrt(np.mean(np.sum(field_m[:, -1] ** 2, axis=-1))))


def largest_tip_distance(one: np.ndarray, other: np.ndarray) -> float:
    """Return the largest tip distance of two fields [m], infinite if one diverged."""
    distance = np.linalg.norm((one - other)[:, -1], axis=-1)
    return float(np.where(np.isfinite(distance), distance, np.inf).max())
