"""How a run ended."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any

from stringcast.data.artifacts import Estimate
from stringcast.pipeline.run.iterations import Iteration
from stringcast.stages.spec import StageSpec


@dataclass(frozen=True)
class RunResult:
    """stage: the one whose artifact the run was for, if it was for one."""

    folder: Path
    iterations: tuple[Iteration, ...]
    sentence: str
    stage: StageSpec | None = None

    @property
    def final_artifact(self) -> Any:
        """The artifact that the run was for."""
        assert self.stage is not None
        return self.iterations[-1].artifacts[self.stage.folder]

    @property
    def last_estimate(self) -> Estimate | None:
        """The last one, if there is any."""
        return next(
            (
                i.artifacts["estimate"]
                for i in reversed(self.iterations)
                if "estimate" in i.artifacts
            ),
            None,
        )

    @property
    def has_hit(self) -> bool:
        """Whether the real tip reached the target."""
        return any(i.has_hit for i in self.iterations)


def run_summary(result: RunResult) -> dict[str, Any]:
    """The run in a few numbers: run.json."""
    rows = []
    for i in result.iterations:
        fit = i.artifacts["estimate"].fit.iloc[0] if "estimate" in i.artifacts else {}
        row = {
            "number": i.number,
            "E_before": fit.get("before"),
            "E_after": fit.get("after"),
        }
        row |= {"rms_m": fit.get("rms_after"), "tip_rms_m": fit.get("tip_after")}
        if "prediction" in i.artifacts:
            score = i.artifacts["prediction"].score.iloc[0]
            row |= {
                "held_out": score["trial"],
                "rms_m": score["rms"],
                "tip_rms_m": score["tip"],
            }
        if i.verdict is not None:
            row |= {
                "hit": i.has_hit,
                "miss_m": i.verdict.distance,
                "t_closest": i.verdict.t,
            }
            row |= {"touched": i.verdict.touched}
        row = {
            name: None if isinstance(value, float) and not isfinite(value) else value
            for name, value in row.items()
        }
        rows.append(row)
    return {"hit": result.has_hit, "sentence": result.sentence, "iterations": rows}
