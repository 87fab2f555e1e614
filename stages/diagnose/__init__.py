"""The diagnosis as a stage: causes of misfit, the extended model, and the gain."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from stringcast.data.diagnoses import Diagnosis
from stringcast.stages.common import MM_PER_M
from stringcast.stages.spec import (
    EXTENDED,
    MODEL,
    CollectedTrials,
    StageSpec,
    StageSummary,
)

VERDICT_TITLES = {
    "none": "No cause",
    "effect": "Cause found",
    "ambiguous": "Cause undecided",
    "partial": "Partly explained",
    "unknown": "Cause unknown",
    "insufficient": "Not enough data",
}


def summary(diagnosis: Diagnosis) -> StageSummary:
    """Summarise the verdict, what each cause is, and how well trials are predicted."""
    rows = [_cause_summary(cause) for cause in diagnosis.causes.itertuples()]
    document = diagnosis.document
    sentence = diagnosis.sentence
    if document["causes"]:
        sentence = f"{sentence} {describe_gain(document['gain'])}".strip()
    title = VERDICT_TITLES[diagnosis.verdict]
    if document["interrupted"]:
        title = "Search interrupted"
    return StageSummary(title, sentence, pd.DataFrame(rows))


def describe_gain(gain: Mapping[str, Any]) -> str:
    """Say by how much held-out trials miss both models; empty if it is not known.

    gain: as of diagnosis.json.
    """
    sizes = gain["rms_m"]
    if None in sizes.values():
        return ""
    base, extended, noise = (
        f"{MM_PER_M * sizes[name]:.1f}" for name in ("base", "extended", "noise_floor")
    )
    return (
        f"Trials that were left out of the fit are predicted to {extended} mm rms, "
        f"and to {base} mm without causes (noise {noise} mm)."
    )


def _cause_summary(cause: Any) -> dict[str, str]:
    value = ""
    interval = ""
    if cause.parameter:
        value = f"{cause.value:.4g}"
        interval = f"{cause.low:.4g} to {cause.high:.4g}"
        if getattr(cause, "at_least", False):
            interval = f"at least {cause.low:.4g}"
    return {
        "cause": cause.effect,
        "probability": f"{cause.probability:.2f}",
        "parameter": cause.parameter.rpartition(".")[2],
        "value": value,
        "95 % interval": interval,
        "unit": cause.unit,
    }


def files(diagnosis: Diagnosis, folder: Path) -> Mapping[str, str]:
    """Write diagnosis.json, with the next motion's folder, and the extended model."""
    document = diagnosis.document
    if document["next_experiment"] is not None:
        motion = (folder / "motion").as_posix() if diagnosis.motion else None
        document["next_experiment"]["motion"] = motion
    return {
        "diagnosis.json": json.dumps(document, indent=2),
        EXTENDED: str(diagnosis.finding["extended"].iloc[0]),
    }


STAGE = StageSpec(
    name="diagnose",
    makes=Diagnosis,
    folder="diagnosis",
    uses=(*MODEL, "obstacles", "diagnose", "seed"),
    run="stages.diagnose.diagnose.run",
    inputs={"trials": CollectedTrials()},
    by=("stages.diagnose.diagnose.diagnose",),
    summary=summary,
    files=files,
    page="stages.report.pages.diagnosis.diagnosis_page",
    is_end=True,
)
