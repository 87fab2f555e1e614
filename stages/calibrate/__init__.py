"""Calibrate: from pictures of a printed board, the lens of a camera and where it sees
the plane of motion.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from stringcast.data.calibration import Calibration
from stringcast.stages.spec import SameIteration, StageSpec, StageSummary

CAMERA = "camera.yaml"  # the camera that a calibration measured, for `camera_from=`


def summary(made: Calibration) -> StageSummary:
    """The calibration's result with its errors, for the terminal."""
    outcome = made.outcome.iloc[0]
    sentence = (
        f"This calibration cannot be used: {made.reason}"
        if made.reason
        else f"The camera is known: reprojection error {outcome['rms']:.2f} px, {outcome['held_out_rms']:.2f} px on "
        f"views left out, {outcome['plane_rms']:.2f} px in the plane of motion."
    )
    rows = [
        {
            "parameter": row.name,
            "value": f"{row.value:.6g}",
            "sigma": f"{row.sigma:.2g}",
            "unit": row.unit,
            "": row.meaning,
        }
        for row in made.measured.itertuples()
    ]
    return StageSummary("the camera", sentence, pd.DataFrame(rows))


def files(made: Calibration, ahead: Path) -> Mapping[str, str]:
    """The camera as settings, if it can be used."""
    return {} if made.reason else {CAMERA: str(made.outcome["camera"].iloc[0])}


STAGE = StageSpec(
    name="calibrate",
    makes=Calibration,
    folder="calibration",
    uses=("camera", "board", "source", "plane", "calibrate", "seed"),
    run="stages.calibrate.calibrate.run",
    inputs={
        "tilted": SameIteration(list),
        "flat": SameIteration(list),
        "board": SameIteration(object),
    },
    by=("stages.calibrate.calibrate.calibrate",),
    summary=summary,
    files=files,
    page="stages.report.pages.calibration.calibration_page",
)
