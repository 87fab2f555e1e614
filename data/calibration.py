"""The artifact of `calibrate`: the lens, the plane of motion, and their errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import pandas as pd

from stringcast.data.schema import Table, parse_columns, tables_by_name

VIEWS = Table(
    "views",
    "the pictures of the board; the last used one is the one in the plane of motion",
    parse_columns("""
    view [1] (int): number of the picture among those given
    plane (bool): the board was held in the plane of motion
    corners [1] (int): corners seen
    reason (text): why it was not used; empty if it was
    rms [px]: distance of measured and reprojected corners, root mean square; NaN if not
        used
    held_out_rms [px]: the same with the lens of the other views; NaN in the plane
    tilt [rad]: between the board's normal and the camera's axis
    distance [m]: of the board's corner from the camera
    picture (bytes): JPEG, grey
    """),
)
CORNERS = Table(
    "corners",
    "corners of the board in the views used",
    parse_columns("""
    view [1] (int): number of the picture among those given
    plane (bool): the board was held in the plane of motion
    corner [1] (int): number of the corner on the board
    u [px]: where it is seen, to the right
    v [px]: where it is seen, down
    fit_u [px]: where the calibrated camera has it
    fit_v [px]: where the calibrated camera has it
    """),
)
MEASURED_PARAMETERS = Table(
    "measured",
    "what was measured of the camera",
    parse_columns("""
    name (text): parameter, as in camera.yaml
    unit (text): its unit
    meaning (text): what it is
    value: best value, in `unit`
    sigma: one standard deviation, in `unit`
    """),
)
CALIBRATION_SUMMARY = Table(
    "outcome",
    "one row: how good it is",
    parse_columns("""
    valid (bool): it can be used
    reason (text): why it cannot; empty if it can
    width [px] (int): of the pictures
    height [px] (int): of the pictures
    rms [px]: reprojection error of the views
    held_out_rms [px]: the same of each with the lens of the others
    plane_rms [px]: reprojection error in the plane of motion
    coverage [1]: share of the picture's cells in which a corner was seen
    spread [rad]: largest angle between two views of the board
    camera (text): the camera as settings, YAML
    """),
)


@dataclass(frozen=True)
class Calibration:
    """A measured camera, made by `calibrate`."""

    views: pd.DataFrame
    corners: pd.DataFrame
    measured: pd.DataFrame
    outcome: pd.DataFrame

    TABLES: ClassVar = tables_by_name(
        VIEWS,
        CORNERS,
        MEASURED_PARAMETERS,
        CALIBRATION_SUMMARY,
    )

    @property
    def reason(self) -> str:
        """The reason why the calibration cannot be used; empty if it can."""
        return str(self.outcome["reason"].iloc[0])
