"""Diagnose: what the simulation gets wrong, its cause, the extended model, and the
gain.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from stringcast.data.artifacts import Diagnosis, TrialSet
from stringcast.stages.spec import (
    EXTENDED,
    MODEL,
    SameIteration,
    StageSpec,
    StageSummary,
)


def summary(made: Diagnosis) -> StageSummary:
    """The verdict, and what each cause is and does."""
    return StageSummary(
        made.verdict,
        made.sentence,
        pd.DataFrame([_cause_summary(cause) for cause in made.causes.itertuples()]),
    )


def _cause_summary(cause: Any) -> dict[str, str]:
    ends = (
        f"at least {cause.low:.4g}"
        if getattr(cause, "at_least", False)
        else f"{cause.low:.4g} to {cause.high:.4g}"
    )
    known = (
        {"value": f"{cause.value:.4g}", "95 % interval": ends}
        if cause.parameter
        else {}
    )
    # which cause's, the first column says
    parameter = cause.parameter.rpartition(".")[2]
    row = {
        "cause": cause.effect,
        "probability": f"{cause.probability:.2f}",
        "parameter": parameter,
    }
    return row | {"value": "", "95 % interval": ""} | known | {"unit": cause.unit}


def files(made: Diagnosis, ahead: Path) -> Mapping[str, str]:
    """diagnosis.json, which also says where the motion lies that is to be performed
    next, and the extended model.
    """
    found = json.loads(made.finding["diagnosis"].iloc[0])
    if found["next_experiment"] is not None:
        found["next_experiment"]["motion"] = (
            (ahead / "motion").as_posix() if made.motion else None
        )
    return {
        "diagnosis.json": json.dumps(found, indent=2),
        EXTENDED: str(made.finding["extended"].iloc[0]),
    }


STAGE = StageSpec(
    name="diagnose",
    makes=Diagnosis,
    folder="diagnosis",
    uses=(*MODEL, "obstacles", "diagnose", "seed"),
    run="stages.diagnose.diagnose.run",
    inputs={"trials": SameIteration(TrialSet)},
    by=("stages.diagnose.diagnose.diagnose",),
    summary=summary,
    files=files,
    page="stages.report.pages.diagnosis.diagnosis_page",
)
