"""Align: rotation, origin and scale of the camera in the arm's frame, and the offset of
their clocks, as measured.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from stringcast.data.alignment import Alignment
from stringcast.data.artifacts import TrialSet
from stringcast.stages.spec import (
    EXTENDED,
    MODEL,
    SameIteration,
    StageSpec,
    StageSummary,
)


def summary(made: Alignment) -> StageSummary:
    """The alignment in a table: pose and clock of the camera relative to the arm's."""
    rows = [
        {
            "parameter": row.name,
            "value": f"{row.value:.2e}",
            "95 % interval": f"{row.low:.2e} to {row.high:.2e}",
            "unit": row.unit,
            "": ""
            if not row.low <= 0 <= row.high
            else "may be 0"
            if row.found
            else "not seen",
        }
        for row in made.measured.itertuples()
    ]
    return StageSummary(
        "camera and clock against the arm", made.sentence, pd.DataFrame(rows)
    )


def files(made: Alignment, ahead: Path) -> Mapping[str, str]:
    """The model with the alignment, as settings."""
    return {EXTENDED: made.extended_yaml}


STAGE = StageSpec(
    name="align",
    makes=Alignment,
    folder="alignment",
    uses=(*MODEL, "align"),
    run="stages.align.align.run",
    inputs={"trials": SameIteration(TrialSet)},
    by=("stages.align.align.align",),
    summary=summary,
    files=files,
    page="stages.report.pages.alignment.alignment_page",
)
