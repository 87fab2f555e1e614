"""One bench of a blind study: drawn, diagnosed, and only then its envelope opened."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from stringcast.hardware.virtual.blind import LATEST
from stringcast.pipeline.provenance import state
from stringcast.pipeline.studies.engine import StudyJob


class Bench(Protocol):
    """A bench with an envelope; see `hardware.virtual.blind` and `hardware.virtual.laboratory`."""

    def write(self, folder: Path) -> None:
        """Write what was measured."""

    def envelope(self, path: Path) -> None:
        """Write what is really so."""


Draw = Callable[[int], Bench]
Diagnose = Callable[[Path], Mapping[str, Any]]
FAILED = "failed"


@dataclass(frozen=True)
class OneBench(StudyJob):
    """A row of the study: the hidden cause of the bench of a seed, and the diagnosis."""

    seed: int
    folder: Path
    draw: Draw
    diagnose: Diagnose

    @property
    def name(self) -> str:
        return f"{self.seed:05d}"

    def __call__(self) -> dict[str, Any]:
        """The row: one bench must not stop the others, and counts as wrong where the diagnosis raises."""
        dataset, envelope = self.folder / "datasets" / self.name, self.folder / "envelopes" / f"{self.name}.json"
        bench = self.draw(self.seed)
        bench.write(dataset)
        bench.envelope(envelope)
        begun = time.perf_counter()
        diagnosis = self._diagnosed(dataset)
        row = {"seed": self.seed, "runtime": time.perf_counter() - begun, "diagnosis": diagnosis}
        truth = json.loads(envelope.read_text(encoding="utf-8"))
        return row | {"truth": truth, "version": truth.get("version", LATEST), "code": state()}

    def _diagnosed(self, dataset: Path) -> Mapping[str, Any]:
        try:
            return self.diagnose(dataset)
        except Exception as error:
            return {"verdict": FAILED, "error": f"{type(error).__name__}: {error}"}
