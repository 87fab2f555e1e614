"""Align: measure pose and clock of the camera relative to the arm."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from stringcast.data.alignment import Alignment
from stringcast.data.artifacts import Film, Trial
from stringcast.stages.spec import (
    EXTENDED,
    MODEL,
    CollectedTrials,
    StageSpec,
    StageSummary,
)


def summary(alignment: Alignment) -> StageSummary:
    """Tabulate pose and clock of the camera relative to the arm."""
    rows = []
    for parameter in alignment.measured.itertuples():
        remark = ""
        if parameter.low <= 0 <= parameter.high:
            remark = "may be 0" if parameter.found else "not seen"
        row = {
            "parameter": parameter.name,
            "value": f"{parameter.value:.2e}",
            "95 % interval": f"{parameter.low:.2e} to {parameter.high:.2e}",
            "unit": parameter.unit,
            "": remark,
        }
        rows.append(row)
    title = "camera and clock relative to the arm"
    return StageSummary(title, alignment.sentence, pd.DataFrame(rows))


def files(alignment: Alignment, folder: Path) -> Mapping[str, str]:
    """Return the model with the alignment as settings."""
    return {EXTENDED: alignment.extended_yaml}


STAGE = StageSpec(
    name="align",
    makes=Alignment,
    folder="alignment",
    uses=(*MODEL, "align"),
    run="stages.align.align.run",
    inputs={"trials": CollectedTrials(parts={"trial": Trial | Film})},
    by=("stages.align.align.align",),
    summary=summary,
    files=files,
    page="stages.report.pages.alignment.alignment_page",
    is_end=True,
)
