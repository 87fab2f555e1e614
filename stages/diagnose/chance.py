"""What the library as a whole would explain of noise alone: the price of asking so many effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from stringcast.stages.diagnose.compare import blocks
from stringcast.stages.diagnose.evidence import Evidence
from stringcast.stages.diagnose.fit import Fit
from stringcast.stages.diagnose.screen import Probe

DRAWS = 400
SELDOM = 0.99  # of draws


def by_chance(evidence: Evidence, fit: Fit, probes: Mapping[str, Sequence[Probe]], seed: int) -> float:
    """Gain of the log-likelihood that the best of all probes exceeds on noise alone in one of a hundred draws.

    The noise is what a fit leaves, with the sign of each piece of time drawn anew (the wild bootstrap, Liu 1988, by
    blocks): as large and as correlated, and nothing in it to be found. Taken to first order, of either sign.
    """
    directions = np.stack([probe.direction for some in probes.values() for probe in some])
    first = np.flatnonzero(np.diff(blocks(evidence), prepend=-1))  # residuals are in the order of time
    sums = np.add.reduceat(directions * fit.residual, first, axis=1)
    signs = np.random.default_rng(seed).choice((-1.0, 1.0), (len(first), DRAWS))
    return float(np.quantile(np.max((sums @ signs) ** 2 / 2, axis=0), SELDOM))
