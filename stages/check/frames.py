"""Films: frames that a camera dropped, and pictures in which no string can be read."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from stringcast.data.metadata import DATASET_FILE
from stringcast.stages.check.clocks import SLOW_RATE, usual_interval
from stringcast.stages.check.finding import Finding, Severity
from stringcast.stages.check.measured import CheckedDataset

GRID_PLACES = 9  # in either direction of a picture, at which it is asked where they lie
# [px] from where a place must come back from the plane: nearer, no pixel is another's
MAX_RETURN_PX = 0.5
# of the places, the outermost of a lens that bends much: no string hangs there
CORNER_SHARE = 0.1
MIN_STRING_PX = 3.0  # [px] of a string: shorter, it has no direction
# pictures that a string is long: a frame shows nothing of its shape
MAX_PICTURES = 20.0
MAX_DROPPED_SHARE = 0.02  # share of a film's frames: so many are more than bad luck


def check_camera_view(measured: CheckedDataset) -> Iterator[Finding]:
    """A picture that the camera's numbers fold, or in which the string would be a speck
    or everything.
    """
    if not measured.data.films:
        return
    camera, size = (
        measured.camera,
        np.array([measured.camera.width, measured.camera.height]),
    )
    places = np.stack(
        np.meshgrid(*(np.linspace(0, side - 1, GRID_PLACES) for side in size)), axis=-1
    ).reshape(-1, 2)
    with np.errstate(all="ignore"):  # what is no number is found
        there = camera.world(places)
        lost = ~(np.linalg.norm(camera.pixels(there) - places, axis=-1) < MAX_RETURN_PX)
    if lost.mean() > CORNER_SHARE:
        severity = Severity.ERROR if lost.mean() > 0.5 else Severity.WARNING
        said = f"{lost.mean():.0%} of the picture lies nowhere in the plane by these numbers, or twice"
        yield Finding(
            severity,
            DATASET_FILE,
            "camera",
            said,
            "Correct lens, distortion or tilt, or calibrate anew",
        )
        return
    with np.errstate(all="ignore"):
        long = measured.length / np.ptp(there[~lost], axis=0)  # in pictures
    if not ((long * size >= MIN_STRING_PX).all() and (long <= MAX_PICTURES).all()):
        said = "by these numbers the string is as long as {:.2g} pictures are wide, and as {:.2g} are high".format(
            *long
        )
        yield Finding(
            Severity.ERROR,
            DATASET_FILE,
            "camera",
            said,
            "Correct px_per_m, width and height, or the lens",
        )


def check_dropped_frames(measured: CheckedDataset) -> Iterator[Finding]:
    """Places on the schedule of a film that are empty."""
    for name, film in measured.data.films.items():
        step = usual_interval(film.t)
        if not 0 < step < SLOW_RATE:
            continue
        lost = int((np.rint(np.diff(film.t) / step) - 1).clip(0).sum())
        share = lost / (len(film.t) + lost)
        if lost:
            said = f"{lost} of {len(film.t) + lost} frames are missing ({share:.1%})"
            remedy = "Where many are: shorten the exposure, film fewer or smaller frames, or free the computer"
            severity = Severity.WARNING if share > MAX_DROPPED_SHARE else Severity.NOTE
            yield Finding(severity, measured.file("frames"), "t", said, remedy, (name,))
