"""A bench with a sealed envelope: what was measured goes into a dataset, what is so
only into the envelope.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from stringcast.data.artifacts import ARM, JOINTS, POINTS
from stringcast.data.dataset import FORMAT_VERSION, with_trial
from stringcast.data.store import write_table, write_text
from tests.benchmarks.simulators.blind.hidden import Hidden
from tests.benchmarks.simulators.blind.scene import Scene


@dataclass(frozen=True)
class BlindBench:
    """The measured data of a bench and its hidden truth. kind: effect, none, outside,
    pair or resolution.
    """

    seed: int
    kind: str
    scene: Scene
    hidden: tuple[Hidden, ...]
    parameters: dict[str, float]
    sizes: dict[str, float]
    paper: float
    points: np.ndarray
    states_sigma: bool

    @property
    def names(self) -> list[str]:
        """Names of the hidden causes."""
        return list(self.sizes)

    def write(self, folder: Path) -> None:
        """The dataset, in the format for measured data of others."""
        scene, names = self.scene, [f"t{i:02d}" for i in range(len(self.scene.casts))]
        parts = [
            pd.DataFrame(
                {"trial": name, "t": cast.t}
                | dict(zip(JOINTS, cast.reported.T, strict=True))
            )
            for name, cast in zip(names, scene.casts, strict=True)
        ]
        write_table(
            with_trial(ARM),
            pd.concat(parts, ignore_index=True),
            folder / "arm.parquet",
            {},
        )
        # a row for each frame and place along the string
        trial = np.repeat(
            names, [len(cast.frames) * len(scene.s) for cast in scene.casts]
        )
        t, s = np.meshgrid(
            np.concatenate([cast.frames for cast in scene.casts]),
            scene.s,
            indexing="ij",
        )
        x, y = self.points.reshape(-1, 2).T
        points = pd.DataFrame(
            {"trial": trial, "t": t.ravel(), "s": s.ravel(), "x": x, "y": y}
        )
        write_table(with_trial(POINTS), points, folder / "points.parquet", {})
        arm, camera = scene.arm, scene.camera
        seen = {
            "fps": camera.fps,
            "width": camera.width,
            "height": camera.height,
            "px_per_m": camera.px_per_m,
        }
        about: dict[str, Any] = {
            "format": FORMAT_VERSION,
            "name": "bench",
            "string": {"length": scene.length},
        }
        about |= {"arm": {"links": list(arm.links), "base": list(arm.base)}}
        about |= {"camera": {**seen, "origin_px": list(camera.origin_px)}}
        about |= {"noise": {"point_sigma": scene.sigma}} if self.states_sigma else {}
        write_text(folder / "dataset.yaml", yaml.safe_dump(about, sort_keys=False))

    def envelope(self, path: Path) -> None:
        """Write what is really so. No stage opens this."""
        acts_in = {h.effect.name: h.only for h in self.hidden}
        truth = {
            "seed": self.seed,
            "kind": self.kind,
            "names": self.names,
            "parameters": self.parameters,
        }
        truth |= {"sizes": self.sizes, "paper": self.paper, "only_in_trial": acts_in}
        truth |= {"base": dict(self.scene.base), "sigma": self.scene.sigma}
        write_text(path, json.dumps(truth, indent=2))
