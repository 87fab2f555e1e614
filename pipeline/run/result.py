"""How a run ended."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, Field, ValidationError, model_validator

from stringcast.data.artifacts import Motion
from stringcast.data.estimates import Estimate, Prediction
from stringcast.data.explanations import MIN_SHOWN_PROBABILITY, Explanation, Surprise
from stringcast.data.file_checks import read_json
from stringcast.data.schema import DataError
from stringcast.pipeline.run.file_names import SUMMARY_FILE
from stringcast.pipeline.run.iterations import Iteration
from stringcast.stages.spec import StageSpec

Finite = Annotated[float, Field(allow_inf_nan=False)]


class IterationSummary(BaseModel):
    """The parts of an iteration in run.json that commands read."""

    number: int
    hit: bool | None = None
    miss_m: Finite | None = None
    E_before: Finite | None = None
    E_after: Finite | None = None


class Summary(BaseModel):
    """The parts of run.json that commands read."""

    sentence: str
    iterations: list[IterationSummary]
    hit: bool | None = None

    @model_validator(mode="after")
    def _require_hit_of_casts(self) -> Summary:
        if self.hit is None and any(each.hit is not None for each in self.iterations):
            raise ValueError("casts state whether they hit, but the run does not")
        return self


@dataclass(frozen=True)
class RunResult:
    """How a run ended.

    Parameters
    ----------
    folder : Path
        Folder of the run.
    iterations : tuple of Iteration
        Casts, or stored trials.
    sentence : str
        The outcome in words.
    stage : StageSpec, optional
        Stage whose artifact is the result of the run, if any.
    """

    folder: Path
    iterations: tuple[Iteration, ...]
    sentence: str
    stage: StageSpec | None = None

    @property
    def final_artifact(self) -> Any:
        """Artifact that is the result of the run."""
        assert self.stage is not None
        return self.iterations[-1].artifacts[self.stage.folder]

    @property
    def last_estimate(self) -> Estimate | None:
        """Estimate of the last iteration that has one."""
        for iteration in reversed(self.iterations):
            if (estimate := iteration.find(Estimate)) is not None:
                return estimate
        return None

    @property
    def has_hit(self) -> bool:
        """Whether the real tip reached the target in a valid trial."""
        return any(iteration.has_hit for iteration in self.iterations)


def run_summary(result: RunResult) -> dict[str, Any]:
    """Return the content of run.json; only a run of casts states a hit."""
    rows: list[dict[str, Any]] = []
    summary: dict[str, Any] = {"sentence": result.sentence, "iterations": rows}
    if any(iteration.verdict is not None for iteration in result.iterations):
        summary["hit"] = result.has_hit
    for iteration in result.iterations:
        row = iteration_summary(iteration)
        if iteration.is_look:
            summary["look"] = row
        else:
            rows.append(row)
    return summary


def iteration_summary(iteration: Iteration) -> dict[str, Any]:
    """Return the summary of an iteration; None for values that are not finite."""
    verdict, estimate = iteration.verdict, iteration.find(Estimate)
    fit: Any = {} if estimate is None else estimate.fit.iloc[0]
    row = {
        "number": iteration.number,
        "E_before": fit.get("before"),
        "E_after": fit.get("after"),
        "rms_m": fit.get("rms_after"),
        "tip_rms_m": fit.get("tip_after"),
    }
    if (prediction := iteration.find(Prediction)) is not None:
        score = prediction.score.iloc[0]
        row["held_out"] = score["trial"]
        row["rms_m"], row["tip_rms_m"] = score["rms"], score["tip"]
    if (motion := iteration.find(Motion)) is not None and verdict is not None:
        row["hit_probability"] = motion.outcome.iloc[0].get("chance")
    if (surprise := iteration.find(Surprise)) is not None:
        row["p_value"], row["surprising"] = surprise.p_value, surprise.is_surprising
    if isinstance(estimate, Explanation):
        row["explanation"] = estimate.verdict
        row["causes"] = {
            name: p for name, p in estimate.causes.items() if p >= MIN_SHOWN_PROBABILITY
        }
    if verdict is not None:
        row["hit"] = iteration.has_hit
        row["miss_m"], row["t_closest"] = verdict.distance, verdict.t
        row["touched"] = verdict.touched
        row["tip_speed_m_s"] = verdict.speed
        row["tip_direction_rad"] = verdict.direction
    for name, value in row.items():
        if isinstance(value, float) and not isfinite(value):
            row[name] = None
    return row


def read_summary(folder: Path) -> dict[str, Any]:
    """Read run.json of a run's folder; empty for a run that has not ended.

    Raises DataError if it is damaged or malformed, as it may be foreign.
    """
    path = folder / SUMMARY_FILE
    summary = read_json(path) if path.is_file() else {}
    try:
        if summary:
            Summary.model_validate(summary, strict=True)
    except ValidationError as error:
        raise DataError(
            path,
            "it does not say how the run ended",
            "Delete it, and resume the run.",
        ) from error
    return summary
