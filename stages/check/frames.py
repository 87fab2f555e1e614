"""Frames that a camera dropped."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from stringcast.stages.check.clocks import SLOW, usual
from stringcast.stages.check.finding import Finding, Severity
from stringcast.stages.check.measured import Measured

MUCH = 0.02  # share of a film's frames: so many are more than bad luck


def dropped(measured: Measured) -> Iterator[Finding]:
    """Places on the schedule of a film that are empty."""
    for name, film in measured.data.films.items():
        step = usual(film.t)
        if not 0 < step < SLOW:
            continue
        lost = int((np.rint(np.diff(film.t) / step) - 1).clip(0).sum())
        share = lost / (len(film.t) + lost)
        if lost:
            said = f"{lost} of {len(film.t) + lost} frames are missing ({share:.1%})"
            remedy = "Where many are: shorten the exposure, film fewer or smaller frames, or free the computer"
            severity = Severity.WARNING if share > MUCH else Severity.NOTE
            yield Finding(severity, measured.file("frames"), "t", said, remedy, (name,))
