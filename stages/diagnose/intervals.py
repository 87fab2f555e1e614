"""How sure fitted parameters are, and whether a cause could as well be absent."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy.special import stdtrit

from stringcast.stages.diagnose.compare import blocks
from stringcast.stages.diagnose.evidence import Evidence
from stringcast.stages.diagnose.fit import PRIOR, Fit
from stringcast.stages.model.effect import Effect, components, placed

CLEARLY = 2.4  # half-widths of its interval that a size must be from absence: five standard deviations, nearly
EDGE = 0.02  # of its size: a cause that would no longer be what it says with so much less would rather be less


def half_width(evidence: Evidence, fit: Fit) -> np.ndarray:
    """Of 95 % intervals of the free chi, (free,): sandwich over pieces of time (White 1980), of which what was expected
    beforehand is one more: that is all that is known where the data say nothing."""
    piece = blocks(evidence)
    count = int(piece.max()) + 1
    gradient = fit.slopes * fit.residual[:, None]
    sums = np.stack([np.bincount(piece, column, count) for column in gradient.T], axis=1)
    bread = np.linalg.inv(fit.normal)
    rest = max(count - len(fit.theory.free), 1)
    variance = count / rest * np.sum((sums @ bread) ** 2, axis=0) + PRIOR * np.sum(bread**2, axis=0)
    return np.asarray(stdtrit(rest, 0.975) * np.sqrt(variance))


def present(evidence: Evidence, fit: Fit, effects: Iterable[type[Effect]]) -> bool:
    """Whether each effect's size is clearly not nothing: one of its components.

    Not asked of what depends on place: something hard is as hard as any, so that its size may be anything, and yet
    the string is elsewhere without it. But what is as soft as it may be would rather be softer, and is something else.
    """
    far = np.abs(fit.chi - fit.theory.start)[fit.theory.free] > CLEARLY * half_width(evidence, fit)
    beyond = {fit.theory.model.names[p]: bool(far[k]) for k, p in enumerate(fit.theory.free)}
    return all(
        _well_within(fit, e) if placed(e) else any(beyond[e.qualified(p)] for p in components(e)) for e in effects
    )


def _well_within(fit: Fit, effect: type[Effect]) -> bool:
    """Whether an effect would still be what it says with a little less of it."""
    less = fit.chi.copy()
    less[fit.theory.model.names.index(effect.qualified(effect.parameters[0]))] *= 1 - EDGE
    return effect.plausible(fit.theory.of(effect, less))
