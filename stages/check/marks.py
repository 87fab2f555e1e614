"""Check of the stated arc lengths of marks by how the string hangs."""

from __future__ import annotations

from collections.abc import Iterator

from stringcast.stages.check.consistency.dataset import MAX_PLACES, measurements_of
from stringcast.stages.check.finding import Finding, warning
from stringcast.stages.check.hanging_string import (
    find_resting_points,
    fit_hanging_string,
)
from stringcast.stages.check.measured import CheckedDataset

MIN_TRIALS = 3  # that begin at rest: fewer have too few shapes of the string
# Reported errors of the place, in metres and of the length. Estimates of right marks
# are within 1 mm, also with wind, heavy tips, and hands that turn too far
MIN_SHIFT_M = 3e-3
MIN_SHIFT = 0.01
MAX_MISFIT = 0.01  # of the length: above it, the fitted shape is not used


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
