"""Checks of films: dropped frames, and a camera that cannot show the string."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from stringcast.data.metadata import DATASET_FILE
from stringcast.stages.check.clocks import MAX_INTERVAL_S, usual_interval
from stringcast.stages.check.finding import Finding, error, note, warning
from stringcast.stages.check.measured import CheckedDataset

GRID_SIZE = 9  # pixels tested in either direction of a picture
# from pixel to plane and back
MAX_RETURN_ERROR_PX = 0.5
# share of pixels without a place in the plane: corners with strong lens distortion
MAX_LOST_CORNERS = 0.1
MIN_STRING_PX = 3.0  # a shorter string shows no direction
MAX_STRING_PICTURES = 20.0  # a longer string shows no shape
MAX_DROPPED_SHARE = 0.02  # of a film's frames


def check_camera_view(dataset: CheckedDataset) -> Iterator[Finding]:
    """Find cameras that fold the picture, or show the string far too small or large."""
    if not dataset.data.films:
        return
    camera = dataset.camera
    size = np.array([camera.width, camera.height])
    columns, rows = (np.linspace(0, side - 1, GRID_SIZE) for side in size)
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    with np.errstate(all="ignore"):  # NaN counts as lost
        places = camera.world(pixels)
        errors = np.linalg.norm(camera.pixels(places) - pixels, axis=-1)
    is_kept = errors < MAX_RETURN_ERROR_PX
    lost = (~is_kept).mean()
    if lost > MAX_LOST_CORNERS:
        statement = (
            f"{lost:.0%} of the picture has no place in the plane by these numbers, or "
            "two"
        )
        remedy = "Correct lens, distortion or tilt, or calibrate again"
        report = error if lost > 0.5 else warning
        yield report(DATASET_FILE, "camera", statement, remedy)
        return

    with np.errstate(all="ignore"):
        pictures = dataset.length / np.ptp(places[is_kept], axis=0)
    is_large_enough = (pictures * size >= MIN_STRING_PX).all()
    if not (is_large_enough and (pictures <= MAX_STRING_PICTURES).all()):
        statement = (
            f"by these numbers the string is as long as {pictures[0]:.2g} pictures are "
            f"wide, and as {pictures[1]:.2g} are high"
        )
        remedy = "Correct px_per_m, width and height, or the lens"
        yield error(DATASET_FILE, "camera", statement, remedy)


def check_dropped_frames(dataset: CheckedDataset) -> Iterator[Finding]:
    """Find frames that are missing from the schedule of a film."""
    for name, film in dataset.data.films.items():
        interval = usual_interval(film.t)
        if not 0 < interval < MAX_INTERVAL_S:
            continue
        lost = int((np.rint(np.diff(film.t) / interval) - 1).clip(0).sum())
        if lost:
            scheduled = len(film.t) + lost
            share = lost / scheduled
            statement = f"{lost} of {scheduled} frames are missing ({share:.1%})"
            remedy = (
                "Where many are: shorten the exposure, film fewer or smaller frames, "
                "or free the computer"
            )
            report = warning if share > MAX_DROPPED_SHARE else note
            yield report(dataset.file("frames"), "t", statement, remedy, name)
