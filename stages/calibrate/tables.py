"""Tables of a calibration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np
import pandas as pd
import yaml

from stringcast.data.calibration import (
    CALIBRATION_SUMMARY,
    CORNERS,
    MEASURED_PARAMETERS,
    VIEWS,
    Calibration,
)
from stringcast.data.file_checks import mark_yaml_end
from stringcast.data.lazy_module import LazyModule
from stringcast.stages.calibrate.acceptance import CalibrationSolution
from stringcast.stages.calibrate.fit import lens_values
from stringcast.stages.calibrate.views import BoardView
from stringcast.stages.common import rms
from stringcast.stages.model.camera import Camera

cv2 = LazyModule("cv2")

LENS_ROWS = (
    ("lens.focal[0]", "px", "focal length across"),
    ("lens.focal[1]", "px", "focal length down"),
    ("lens.centre[0]", "px", "principal point, to the right"),
    ("lens.centre[1]", "px", "principal point, down"),
    ("lens.distortion[0]", "1", "k1, radial"),
    ("lens.distortion[1]", "1", "k2, radial"),
    ("lens.distortion[2]", "1", "p1, tangential"),
    ("lens.distortion[3]", "1", "p2, tangential"),
)
PLANE_ROWS = (
    ("px_per_m", "px/m", "scale where the axis meets the plane of motion"),
    ("origin_px[0]", "px", "pixel of the world's origin, to the right"),
    ("origin_px[1]", "px", "pixel of the world's origin, down"),
    ("rotation", "rad", "counter-clockwise rotation of the world in the picture"),
    ("tilt[0]", "rad", "tilt of the plane about the camera's x"),
    ("tilt[1]", "rad", "tilt of the plane about the camera's y"),
)


def calibration_tables(
    solution: CalibrationSolution, views: Sequence[BoardView], reason: str
) -> Calibration:
    """Return a calibration as tables.

    Parameters
    ----------
    solution
        The results.
    views
        All views of the tilted board, used or not.
    reason
        Why the calibration cannot be used; empty if it can.

    Returns
    -------
    Calibration
        Views, corners, parameters and summary.
    """
    corners = []
    for view, error in zip(solution.used_views, solution.lens.errors, strict=True):
        corners.append(_corner_rows(view, view.pixels - error, plane=False))
    corners.append(_corner_rows(solution.plane_view, solution.plane.fit, plane=True))
    camera = solution.plane.camera
    assert camera.lens is not None
    values = [
        *lens_values(camera.lens),
        camera.px_per_m,
        *camera.origin_px,
        camera.rotation,
        *camera.tilt,
    ]
    sigma = [*np.sqrt(np.diag(solution.lens.covariance)), *solution.plane.sigma]
    measured = pd.DataFrame(
        [*LENS_ROWS, *PLANE_ROWS], columns=["name", "unit", "meaning"]
    ).assign(value=values, sigma=sigma)
    outcome = {
        "valid": not reason,
        "reason": reason,
        "width": solution.size[0],
        "height": solution.size[1],
        "rms": solution.lens.rms,
        "held_out_rms": rms(solution.held_out_rms),
        "plane_rms": solution.plane_rms,
        "coverage": float(solution.covered_cells.mean()),
        "spread": solution.spread,
        "camera": camera_settings(camera),
    }
    return Calibration(
        VIEWS.check(_view_rows(solution, views)),
        CORNERS.check(pd.concat(corners, ignore_index=True)),
        MEASURED_PARAMETERS.check(measured),
        CALIBRATION_SUMMARY.check(pd.DataFrame([outcome])),
    )


def camera_settings(camera: Camera) -> str:
    """Return the text of camera.yaml: the settings of a camera."""
    values = _plain_values(asdict(camera))
    text = yaml.safe_dump(values, sort_keys=False, default_flow_style=None)
    return mark_yaml_end(text)


def _view_rows(
    solution: CalibrationSolution, views: Sequence[BoardView]
) -> pd.DataFrame:
    """Return a row for every view; that in the plane of motion is last."""
    lens, camera = solution.lens, solution.plane.camera
    tilts = np.arccos(np.clip(np.abs(lens.normals[:, 2]), 0, 1))
    columns = {
        "rms": solution.errors,
        "held_out_rms": solution.held_out_rms,
        "tilt": tilts,
        "distance": [np.linalg.norm(place) for _, place in lens.poses],
    }
    numbers = [view.number for view in solution.used_views]
    results = pd.DataFrame(columns, index=numbers)
    tilted = pd.DataFrame([_view_row(view, plane=False) for view in views])
    assert camera.lens is not None
    flat = {"rms": solution.plane_rms, "held_out_rms": np.nan}
    flat["tilt"] = float(np.arccos(np.cos(camera.tilt[0]) * np.cos(camera.tilt[1])))
    flat["distance"] = camera.lens.mean_focal / camera.px_per_m
    in_plane = pd.DataFrame([_view_row(solution.plane_view, plane=True) | flat])
    return pd.concat([tilted.join(results, on="view"), in_plane])


def _view_row(view: BoardView, plane: bool) -> dict[str, object]:
    success, jpeg = cv2.imencode(".jpg", view.image, [cv2.IMWRITE_JPEG_QUALITY, 80])
    assert success
    return {
        "view": view.number,
        "plane": plane,
        "corners": len(view.corners),
        "reason": view.reason,
        "picture": jpeg.tobytes(),
    }


def _corner_rows(view: BoardView, fit: np.ndarray, plane: bool) -> pd.DataFrame:
    columns = {
        "view": view.number,
        "plane": plane,
        "corner": view.corners,
        "u": view.pixels[:, 0],
        "v": view.pixels[:, 1],
        "fit_u": fit[:, 0],
        "fit_v": fit[:, 1],
    }
    return pd.DataFrame(columns)


def _plain_values(value: object) -> object:
    """Convert tuples and NumPy's numbers to types of YAML."""
    if isinstance(value, dict):
        return {name: _plain_values(inside) for name, inside in value.items()}
    if isinstance(value, list | tuple):
        return [_plain_values(inside) for inside in value]
    return float(f"{value:.10g}") if isinstance(value, float) else value
