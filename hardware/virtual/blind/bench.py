"""A bench with a sealed envelope: what was measured goes into a dataset, what is so only into the envelope."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from stringcast.data.artifacts import ARM, JOINTS, POINTS
from stringcast.data.dataset import FORMAT, with_trial
from stringcast.data.store import write_table, write_text
from stringcast.hardware.virtual.blind.hidden import Hidden
from stringcast.hardware.virtual.blind.scene import Scene


@dataclass(frozen=True)
class BlindBench:
    """The measured data of a bench and its hidden truth. kind: effect, none, outside, pair or resolution."""

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
        parts = [
            pd.DataFrame({"trial": f"t{i:02d}", "t": cast.t} | dict(zip(JOINTS, cast.reported.T, strict=True)))
            for i, cast in enumerate(self.scene.casts)
        ]
        write_table(with_trial(ARM), pd.concat(parts, ignore_index=True), folder / "arm.parquet", {})
        write_table(with_trial(POINTS), self._points(), folder / "points.parquet", {})
        write_text(folder / "dataset.yaml", yaml.safe_dump(self._about(), sort_keys=False))

    def envelope(self, path: Path) -> None:
        """Write what is really so. No stage opens this."""
        acts_in = {h.effect.name: h.only for h in self.hidden}
        truth = {"seed": self.seed, "kind": self.kind, "names": self.names, "parameters": self.parameters}
        truth |= {"sizes": self.sizes, "paper": self.paper, "only_in_trial": acts_in}
        truth |= {"base": dict(self.scene.base), "sigma": self.scene.sigma}
        write_text(path, json.dumps(truth, indent=2))

    def _about(self) -> dict[str, Any]:
        arm, camera = self.scene.arm, self.scene.camera
        seen = {"fps": camera.fps, "width": camera.width, "height": camera.height, "px_per_m": camera.px_per_m}
        about: dict[str, Any] = {"format": FORMAT, "name": "bench", "string": {"length": self.scene.length}}
        about |= {"arm": {"links": list(arm.links), "base": list(arm.base)}}
        about |= {"camera": {**seen, "origin_px": list(camera.origin_px)}}
        return about | ({"noise": {"point_sigma": self.scene.sigma}} if self.states_sigma else {})

    def _points(self) -> pd.DataFrame:
        trial = np.repeat(
            [f"t{i:02d}" for i in range(len(self.scene.casts))], [len(c.frames) for c in self.scene.casts]
        )
        t, s = np.meshgrid(np.concatenate([c.frames for c in self.scene.casts]), self.scene.s, indexing="ij")
        x, y = self.points.reshape(-1, 2).T
        return pd.DataFrame(
            {"trial": np.repeat(trial, len(self.scene.s)), "t": t.ravel(), "s": s.ravel(), "x": x, "y": y}
        )
