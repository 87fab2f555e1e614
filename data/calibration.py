"""The artifact of `calibrate`: the lens, the plane of motion, and their errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import pandas as pd
import yaml

from stringcast.data.schema import Column, Table

VIEWS = Table(
    "views",
    "the pictures of the board; the last used one is the one in the plane of motion",
    (
        Column("view", "1", "number of the picture among those given", "int"),
        Column("plane", "", "the board was held in the plane of motion", "bool"),
        Column("corners", "1", "corners seen", "int"),
        Column("reason", "", "why it was not used; empty if it was", "text"),
        Column(
            "rms",
            "px",
            "distance of measured and reprojected corners, root mean square; NaN if not used",
        ),
        Column(
            "held_out_rms",
            "px",
            "the same with the lens of the other views; NaN in the plane",
        ),
        Column("tilt", "rad", "between the board's normal and the camera's axis"),
        Column("distance", "m", "of the board's corner from the camera"),
        Column("picture", "", "JPEG, grey", "bytes"),
    ),
)
CORNERS = Table(
    "corners",
    "corners of the board in the views used",
    (
        Column("view", "1", "number of the picture among those given", "int"),
        Column("plane", "", "the board was held in the plane of motion", "bool"),
        Column("corner", "1", "number of the corner on the board", "int"),
        Column("u", "px", "where it is seen, to the right"),
        Column("v", "px", "where it is seen, down"),
        Column("fit_u", "px", "where the calibrated camera has it"),
        Column("fit_v", "px", "where the calibrated camera has it"),
    ),
)
MEASURED_PARAMETERS = Table(
    "measured",
    "what was measured of the camera",
    (
        Column("name", "", "parameter, as in camera.yaml", "text"),
        Column("unit", "", "its unit", "text"),
        Column("meaning", "", "what it is", "text"),
        Column("value", "", "best value, in `unit`"),
        Column("sigma", "", "one standard deviation, in `unit`"),
    ),
)
CALIBRATION_SUMMARY = Table(
    "outcome",
    "one row: how good it is",
    (
        Column("valid", "", "it can be used", "bool"),
        Column("reason", "", "why it cannot; empty if it can", "text"),
        Column("width", "px", "of the pictures", "int"),
        Column("height", "px", "of the pictures", "int"),
        Column("rms", "px", "reprojection error of the views"),
        Column("held_out_rms", "px", "the same of each with the lens of the others"),
        Column("plane_rms", "px", "reprojection error in the plane of motion"),
        Column(
            "coverage", "1", "share of the picture's cells in which a corner was seen"
        ),
        Column("spread", "rad", "largest angle between two views of the board"),
        Column("camera", "", "the camera as settings, YAML", "text"),
    ),
)


@dataclass(frozen=True)
class Calibration:
    """A measured camera: what `calibrate` makes."""

    views: pd.DataFrame
    corners: pd.DataFrame
    measured: pd.DataFrame
    outcome: pd.DataFrame

    TABLES: ClassVar[dict[str, Table]] = {
        "views": VIEWS,
        "corners": CORNERS,
        "measured": MEASURED_PARAMETERS,
        "outcome": CALIBRATION_SUMMARY,
    }

    @property
    def reason(self) -> str:
        """The reason why the calibration cannot be used; empty if it can."""
        return str(self.outcome["reason"].iloc[0])

    @property
    def camera(self) -> dict[str, Any]:
        """Settings of the camera."""
        settings: dict[str, Any] = yaml.safe_load(self.outcome["camera"].iloc[0])
        return settings
