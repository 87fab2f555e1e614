"""Mass points enough: as few as do not matter, for each costs time, and as many as the theory at hand asks for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stringcast.stages.diagnose.evidence import Evidence
from stringcast.stages.diagnose.fit import Fit, fitted
from stringcast.stages.diagnose.theory import Theory

SEGMENTS = ((10, 14), (14, 20), (20, 28), (28, 40), (40, 56), (56, 80))  # pairs from which results are extrapolated
DOUBTFUL = 1.5  # times the noise: a point whose simulation is as uncertain as that says less
MANY = 0.35  # share of doubtful points from which more mass points are taken
WORSE = 1.1  # times the mean square that the next more mass points leave
STEPS = 20


def refined(noisy: Evidence, theory: Theory, chi: np.ndarray) -> Evidence:
    """With the fewest mass points whose own error does not matter for most of the data, and their doubt.

    noisy: with the noise alone as sigma; fewer points than its own are not tried, and one number stands as it is.
    More points may not fit much better: parameters can make up for too few, and then doubt is small where they are. A
    few more may fit no better where many more do. What is noise alone nothing fits better.
    """
    if len(noisy.segments) == 1:
        return noisy
    pairs = SEGMENTS[SEGMENTS.index(noisy.segments) :]
    here = _fitted(noisy, pairs[0], theory, chi)
    for few, more, most in zip(pairs[:-1], pairs[1:], (*pairs[2:], pairs[-1]), strict=True):
        doubted = replace(noisy, segments=few).doubted(theory.model, here.chi, more)
        sure, least = np.mean(doubted.sigma > DOUBTFUL * noisy.sigma) < MANY, here.mean_square / WORSE
        if (sure and least < 1) or more == pairs[-1]:  # there are no more to go on to
            break
        there = _fitted(noisy, more, theory, here.chi)
        if sure and least < there.mean_square and least < _fitted(noisy, most, theory, there.chi).mean_square:
            break
        here = there
    return doubted


def _fitted(noisy: Evidence, segments: tuple[int, ...], theory: Theory, chi: np.ndarray) -> Fit:
    return fitted(replace(noisy, segments=segments), [theory], [chi], STEPS)[0]


def finer(segments: tuple[int, ...]) -> tuple[int, ...]:
    """The next numbers of segments, by which the error of these is judged; a single one stands as it is."""
    return segments if len(segments) == 1 else (segments[1], 2 * segments[0])
