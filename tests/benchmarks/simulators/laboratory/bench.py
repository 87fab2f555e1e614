"""A bench of a laboratory: measurements go into a dataset, the hidden causes only into
its truth.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from stringcast.data.artifacts import ARM, JOINTS, POINTS
from stringcast.data.dataset import FORMAT_VERSION, with_trial
from stringcast.data.store import write_table, write_text
from tests.benchmarks.simulators.laboratory.scene import Scene
from tests.benchmarks.simulators.laboratory.version import SINGLE


@dataclass(frozen=True)
class TrueCause:
    """One cause that is hidden. name: in the laboratory's terms. library: names any of
    which is right; none if it is outside. settings: how it is hidden. parameters: those
    of the library that mean the same. size_m: root mean square at the tip of what base
    parameters and the other causes cannot explain, linearised. only: the trial in which
    it acts, or null.
    """

    name: str
    library: tuple[str, ...]
    settings: dict[str, float]
    parameters: dict[str, float]
    size_m: float
    only: str | None


@dataclass(frozen=True)
class Truth:
    """The ground truth of a bench. kind: none, single, pair, triple or outside. base:
    the string by the model's parameters. numerical_m: of each trial, how far the tip is
    at most from where a coarser mesh and step have it. chaotic: trials that are not
    known to a third of the noise and were kept. redrawn: trials that were not, and were
    not. left_m: of an outside cause, what the likeliest single effect of the library
    leaves at the tip, linearised; else its size.
    """

    laboratory: str
    version: int
    seed: int
    kind: str
    causes: tuple[TrueCause, ...]
    base: dict[str, float]
    sigma: float
    numerical_m: dict[str, float]
    chaotic: tuple[str, ...]
    redrawn: int
    left_m: float

    @property
    def names(self) -> list[str]:
        """The name of each cause that a diagnosis should give first; the laboratory's
        own where the library has none.
        """
        return [
            cause.library[0] if cause.library else cause.name for cause in self.causes
        ]


@dataclass(frozen=True)
class LabBench:
    """A drawn bench. scene: its casts are the trials. points: (F, S, 2) measured in
    each [m]. states_sigma: the dataset states its noise.
    """

    scene: Scene
    points: tuple[np.ndarray, ...]
    states_sigma: bool
    truth: Truth

    def write(self, folder: Path) -> None:
        """The dataset, in the format for measured data of others."""
        parts = [
            pd.DataFrame(
                {"trial": trial_name(i), "t": cast.t}
                | dict(zip(JOINTS, cast.reported.T, strict=True))
            )
            for i, cast in enumerate(self.scene.casts)
        ]
        write_table(
            with_trial(ARM),
            pd.concat(parts, ignore_index=True),
            folder / "arm.parquet",
            {},
        )
        write_table(with_trial(POINTS), self._points(), folder / "points.parquet", {})
        write_text(
            folder / "dataset.yaml", yaml.safe_dump(self._about(), sort_keys=False)
        )

    def envelope(self, path: Path) -> None:
        """Write the ground truth, as `blind.BlindBench` does, and what only
        laboratories know of it. No stage opens this.

        alike: other names of the library that are as right, and which of `names` they
        stand for.
        """
        truth, causes = self.truth, self.truth.causes
        named = dict(zip(truth.names, causes, strict=True))
        kind = "effect" if truth.kind == SINGLE else truth.kind
        known = {
            "seed": truth.seed,
            "kind": kind,
            "names": truth.names,
            "base": truth.base,
            "sigma": truth.sigma,
        }
        known |= {
            "parameters": {
                name: value
                for cause in causes
                for name, value in cause.parameters.items()
            }
        }
        known |= {
            "sizes": {name: cause.size_m / truth.sigma for name, cause in named.items()}
        }
        known |= {
            "alike": {
                other: name
                for name, cause in named.items()
                for other in cause.library[1:]
            }
        }
        write_text(path, json.dumps(asdict(truth) | known, indent=2))

    def _about(self) -> dict[str, Any]:
        arm, camera = self.scene.arm, self.scene.camera
        seen = {
            "fps": camera.fps,
            "width": camera.width,
            "height": camera.height,
            "px_per_m": camera.px_per_m,
        }
        about: dict[str, Any] = {
            "format": FORMAT_VERSION,
            "name": "bench",
            "string": {"length": self.scene.rod.length},
        }
        about |= {"arm": {"links": list(arm.links), "base": list(arm.base)}}
        about |= {"camera": {**seen, "origin_px": list(camera.origin_px)}}
        return about | (
            {"noise": {"point_sigma": self.scene.sigma}} if self.states_sigma else {}
        )

    def _points(self) -> pd.DataFrame:
        parts = []
        for i, (cast, points) in enumerate(
            zip(self.scene.casts, self.points, strict=True)
        ):
            t, s = np.meshgrid(cast.frames, self.scene.s, indexing="ij")
            x, y = points.reshape(-1, 2).T
            parts.append(
                pd.DataFrame(
                    {
                        "trial": trial_name(i),
                        "t": t.ravel(),
                        "s": s.ravel(),
                        "x": x,
                        "y": y,
                    }
                )
            )
        return pd.concat(parts, ignore_index=True)


def trial_name(number: int) -> str:
    """The name of a trial in the dataset."""
    return f"t{number:02d}"
