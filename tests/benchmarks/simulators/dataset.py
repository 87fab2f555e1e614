"""A synthetic dataset: measurements without the causes, and the ground truth apart."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from stringcast.data.artifacts import ARM, JOINTS, POINTS
from stringcast.data.metadata import FORMAT_VERSION
from stringcast.data.store import write_table, write_text
from stringcast.data.table_files import with_trial
from tests.benchmarks.simulators.scene import Scene

# effects of the library that are nuisances, by the simulator's setting
NUISANCE_EFFECTS = {"camera.offset": "time_offset"}


@dataclass(frozen=True)
class TrueCause:
    """A hidden cause.

    Parameters
    ----------
    name : the library's name for it, or its own if it is outside the library
    alike : other names of the library that are as right
    settings : how it is hidden, in the simulator's terms
    parameters : of the library, where some mean the same
    size_m : rms displacement of the tip that neither base parameters nor the other
        causes explain, linearised
    only_trial : the one trial in which it acts, None for all
    """

    name: str
    alike: tuple[str, ...]
    settings: dict[str, float]
    parameters: dict[str, float]
    size_m: float
    only_trial: str | None


@dataclass(frozen=True)
class GroundTruth:
    """The hidden content of a dataset.

    Parameters
    ----------
    simulator, seed, kind : what was drawn
    causes : the hidden causes
    base : the string by the model's base parameters
    sigma : noise in x and in y [m]
    numerical_error_m : at most, at the tip, by trial
    chaotic : trials that are kept although this error is large
    redrawn : number of casts that were not kept for this reason
    unexplained_m : of an outside cause, what the likeliest single effect of the library
        leaves at the tip, linearised; else the size of the smallest cause
    nuisances : small errors of clock and arc lengths, in the simulator's terms
    """

    simulator: str
    seed: int
    kind: str
    causes: tuple[TrueCause, ...]
    base: dict[str, float]
    sigma: float
    numerical_error_m: dict[str, float]
    chaotic: tuple[str, ...]
    redrawn: int
    unexplained_m: float
    nuisances: dict[str, float] = field(default_factory=dict)

    @property
    def names(self) -> list[str]:
        """The name of each cause."""
        return [cause.name for cause in self.causes]

    def document(self) -> dict[str, Any]:
        """Return what the truth file holds: all fields, and what scores need of them.

        `sizes` are in noise sigmas; `alike` maps other right names to those of `names`;
        `tolerated` are names of small errors, which are no false causes.
        """
        parameters: dict[str, float] = {}
        sizes: dict[str, float] = {}
        alike: dict[str, str] = {}
        for cause in self.causes:
            parameters |= cause.parameters
            sizes[cause.name] = cause.size_m / self.sigma
            alike |= dict.fromkeys(cause.alike, cause.name)
        scored: dict[str, Any] = {
            "parameters": parameters,
            "sizes": sizes,
            "alike": alike,
        }
        tolerated = [NUISANCE_EFFECTS.get(name, "") for name in self.nuisances]
        scored["tolerated"] = list(filter(None, tolerated))
        return asdict(self) | {"names": self.names} | scored


@dataclass(frozen=True)
class SyntheticDataset:
    """Measurements of a scene's casts.

    Parameters
    ----------
    scene : its casts are the trials
    points : (F, S, 2) measured in each [m]
    states_noise : the dataset states its noise
    truth : what is hidden
    """

    scene: Scene
    points: tuple[np.ndarray, ...]
    states_noise: bool
    truth: GroundTruth

    def write(self, folder: Path) -> None:
        """Write the measurements in the format for datasets."""
        write_table(with_trial(ARM), self._arm_table(), folder / "arm.parquet", {})
        points = self._points_table()
        write_table(with_trial(POINTS), points, folder / "points.parquet", {})
        description = yaml.safe_dump(self._description(), sort_keys=False)
        write_text(folder / "dataset.yaml", description)

    def write_truth(self, path: Path) -> None:
        """Write the ground truth. No stage reads it."""
        write_text(path, json.dumps(self.truth.document(), indent=2))

    def _arm_table(self) -> pd.DataFrame:
        tables = []
        for number, cast in enumerate(self.scene.casts):
            angles = dict(zip(JOINTS, cast.reported.T, strict=True))
            columns = {"trial": trial_name(number), "t": cast.t} | angles
            tables.append(pd.DataFrame(columns))
        return pd.concat(tables, ignore_index=True)

    def _points_table(self) -> pd.DataFrame:
        tables = []
        for number, cast in enumerate(self.scene.casts):
            t, s = np.meshgrid(cast.frames, self.scene.s, indexing="ij")
            x, y = self.points[number].reshape(-1, 2).T
            name = trial_name(number)
            columns = {"trial": name, "t": t.ravel(), "s": s.ravel(), "x": x, "y": y}
            tables.append(pd.DataFrame(columns))
        return pd.concat(tables, ignore_index=True)

    def _description(self) -> dict[str, Any]:
        arm, camera = self.scene.arm, self.scene.camera
        description: dict[str, Any] = {
            "format": FORMAT_VERSION,
            "name": "synthetic",
            "string": {"length": self.scene.rod.length},
            "arm": {"links": list(arm.links), "base": list(arm.base)},
            "camera": {
                "fps": camera.fps,
                "width": camera.width,
                "height": camera.height,
                "px_per_m": camera.px_per_m,
                "origin_px": list(camera.origin_px),
            },
        }
        if self.states_noise:
            description["noise"] = {"point_sigma": self.scene.sigma}
        return description


def trial_name(number: int) -> str:
    """Return the name of a trial in the dataset."""
    return f"t{number:02d}"
