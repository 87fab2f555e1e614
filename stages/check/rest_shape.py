"""Checks of stated lengths by the shape of the string at rest."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from stringcast.data.metadata import DATASET_FILE
from stringcast.stages.check.consistency.dataset import (
    MAX_PLACES,
    judge_dataset,
    measurements_of,
)
from stringcast.stages.check.finding import Finding, warning
from stringcast.stages.check.hanging_string import (
    RestingPoints,
    find_resting_points,
    fit_hanging_string,
)
from stringcast.stages.check.measured import CheckedDataset
from stringcast.stages.common import MM_PER_M

MIN_TRIALS = 3  # that begin at rest: fewer have too few shapes of the string
# Reported errors of the place, in metres and of the length. Estimates of right marks
# are within 1 mm, also with wind, heavy tips, and hands that turn too far
MIN_SHIFT_M = 3e-3
MIN_SHIFT = 0.01
MAX_MISFIT = 0.01  # of the length: above it, the fitted shape is not used

MIN_POINTS = 2  # fewer do not distinguish length, stiffness and set
MIN_TIP_SHARE = 0.99  # of the length: the rod ends at the outermost point
# In 30 right datasets of chains of masses, the fitted length of the rod has an error of
# at most 0.8 %, and the right length at most 1.35 times the misfit of the fitted one.
# In seven, lengths wrong by 10 mm have at least 2.3 times that misfit.
MIN_LENGTH_ERROR = 0.02
MIN_MISFIT_RATIO = 2.0
MIN_EXCESS = 0.01  # of the length: stretch and errors of the arm's pose are less
LENGTH_REMEDY = (
    "Measure the string from the grasp to the tip; if its length is right, measure "
    "arm.links and arm.base"
)


def check_mark_places(dataset: CheckedDataset) -> Iterator[Finding]:
    """Find marks whose arc length seems to differ from the stated one."""
    places = set[float]()
    for trial in dataset.with_points():
        places |= {*trial.points["s"].round(4)}
    if not 2 <= len(places) <= MAX_PLACES:
        return  # more points are a centre-line, measured in the picture
    measured = measurements_of(dataset)
    if not {round(s, 4) for s in measured.stated_arc_lengths} <= places:
        return  # places change in every frame, and points are interpolated
    resting = find_resting_points(measured)
    if resting is None or len(resting.hands) < MIN_TRIALS:
        return
    stated = [float(name) for name in resting.names]
    hanging = fit_hanging_string(resting, stated[-1])
    length = dataset.length
    if hanging.misfit_m > MAX_MISFIT * length:
        return
    for place, found in zip(stated, hanging.arc_lengths.values(), strict=True):
        if abs(found - place) > max(MIN_SHIFT_M, MIN_SHIFT * length):
            statement = f"the points at {place:.3f} m hang as if at {found:.3f} m"
            remedy = (
                "Measure again how far along the straight string they are, and correct "
                "s; `import` finds it if no --at is given"
            )
            yield warning(dataset.points_file, "s", statement, remedy)


def check_resting_length(dataset: CheckedDataset) -> Iterator[Finding]:
    """Find a stated length with which the string does not hang as a heavy rod."""
    measured = measurements_of(dataset)
    length = measured.length
    if length is None or dataset.geometry_is_measured:
        return
    arc_lengths = measured.stated_arc_lengths
    if not arc_lengths or max(arc_lengths) < MIN_TIP_SHARE * length:
        return
    if not judge_dataset(dataset).is_consistent:
        return
    resting = find_resting_points(measured)
    if resting is None:
        return
    if len(resting.names) < MIN_POINTS:
        yield from find_too_far_tip(resting, length)
        return

    free = fit_hanging_string(resting, None)
    if abs(free.length / length - 1) < MIN_LENGTH_ERROR:
        return
    stated = fit_hanging_string(resting, length)
    if free.is_rod and stated.misfit_m > MIN_MISFIT_RATIO * free.misfit_m:
        statement = (
            f"at rest, the points are {MM_PER_M * stated.misfit_m:.1f} mm from a heavy "
            f"rod of the stated {length:.3f} m, and {MM_PER_M * free.misfit_m:.1f} mm "
            f"from one of {free.length:.3f} m"
        )
        yield warning(DATASET_FILE, "string.length", statement, LENGTH_REMEDY)


def find_too_far_tip(resting: RestingPoints, length: float) -> Iterator[Finding]:
    """Find a trial in which the tip rests farther from the grasp than it can."""
    reach_m = np.linalg.norm(resting.places[:, -1], axis=1)  # (K,)
    k = int(np.nanargmax(reach_m))
    if reach_m[k] > (1 + MIN_EXCESS) * length:
        statement = (
            f"at rest, the string's end is {reach_m[k]:.3f} m from the grasp in trial "
            f"{resting.trials[k]}, and the string is said to be {length:.3f} m long"
        )
        yield warning(DATASET_FILE, "string.length", statement, LENGTH_REMEDY)
