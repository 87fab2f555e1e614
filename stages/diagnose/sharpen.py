"""The last fit: with more mass points than were needed to find the cause.

Where nobody could see how many there are, a parameter may still hang on it: thousands of points agree on it, and what
is a tenth of the noise in each of them moves it by several of its standard deviations.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stages.diagnose.evidence import Evidence
from stages.diagnose.fit import Fit, fitted
from stages.diagnose.resolve import finer

STEPS = 6


@dataclass(frozen=True)
class Sharp:
    """fit: with mass points that lie half as far apart. doubt: by how much the free chi moved on the second half of the
    way there, (free,)."""

    fit: Fit
    doubt: np.ndarray


def sharpened(evidence: Evidence, fit: Fit) -> Sharp:
    """The fit with the next more mass points, and the next."""
    fits = [fit]
    for segments in (finer(evidence.segments), finer(finer(evidence.segments))):
        fits += fitted(replace(evidence, segments=segments), [fit.theory], [fits[-1].chi], STEPS)
    _, before, after = fits
    return Sharp(after, np.abs(after.chi - before.chi)[fit.theory.free])
