"""The calibrate stage: lens and plane of motion from pictures of a printed board."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from stringcast.data.calibration import Calibration
from stringcast.stages.spec import SameIteration, StageSpec, StageSummary

CAMERA = "camera.yaml"  # the measured camera, for `camera_from=`


def summary(calibration: Calibration) -> StageSummary:
    """Return the camera's parameters with their errors, as a table."""
    outcome = calibration.outcome.iloc[0]
    sentence = (
        f"The camera is known: reprojection error {outcome['rms']:.2f} px, "
        f"{outcome['held_out_rms']:.2f} px on views left out, "
        f"{outcome['plane_rms']:.2f} px in the plane of motion."
    )
    if calibration.reason:
        sentence = f"This calibration cannot be used: {calibration.reason}"
    rows = []
    for parameter in calibration.measured.itertuples():
        row = {
            "parameter": parameter.name,
            "value": f"{parameter.value:.6g}",
            "sigma": f"{parameter.sigma:.2g}",
            "unit": parameter.unit,
            "": parameter.meaning,
        }
        rows.append(row)
    return StageSummary("the camera", sentence, pd.DataFrame(rows))


def files(calibration: Calibration, folder: Path) -> Mapping[str, str]:
    """Return the camera's settings, if the calibration is accepted."""
    if calibration.reason:
        return {}
    return {CAMERA: str(calibration.outcome["camera"].iloc[0])}


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
    is_end=True,
)
