"""The incremental rotation of a segment in a step, as source text for the step loop.

`turned(cross, dot)` [rad] takes the cross and dot products of the old and new segment,
and uses atan(d) = d sum_k a_k d^(2k). The a_k were fitted by `fit_atan_coefficients`
(NumPy 2.4). They are constants because the last digits of a fit depend on LAPACK, and
the compiled loop and its results depend on them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

ATAN_COEFFICIENTS_TO_HALF = (  # |d| <= 0.5, error below 2e-10
    *(0.9999999999885514, -0.3333333273894576),
    *(0.19999949158158573, -0.1428404706057097),
    *(0.11083986537731327, -0.08846896396469683),
    *(0.06431530938552818, -0.02966735928010546),
)
ATAN_COEFFICIENTS_TO_ONE = (  # |d| <= 1, error below 1e-10
    *(0.9999999999390133, -0.33333331518199644),
    *(0.19999909957055376, -0.14283948421650622),
    *(0.11092984790309315, -0.08979051060947522),
    *(0.07242284175647357, -0.05421530905247356),
    *(0.03413342379719368, -0.016055161289434232),
    *(0.0048272280655311675, -0.0006804973287730738),
)


def fit_atan_coefficients(degree: int, limit: float) -> np.ndarray:
    """Fit coefficients a_k (degree,) of atan(d) = d sum_k a_k d^(2k).

    The nodes are Chebyshev's in d^2 for |d| <= limit.
    """
    nodes = np.polynomial.chebyshev.chebpts1(200)
    d2 = (nodes + 1.0) / 2.0 * limit**2
    d = np.sqrt(d2)
    return np.polynomial.polynomial.polyfit(d2, np.arctan(d) / d, degree - 1)


def _horner_source(coefficients: Sequence[float]) -> str:
    """Return Horner's form of sum_k a_k d2^k as text."""
    *lower, text = map(repr, coefficients)
    for coefficient in reversed(lower):
        text = f"({coefficient} + d2 * {text})"
    return text


# For small steps: accurate up to 26 degrees, wrong from 90.
SMALL_TURN_SOURCE = f"""
@njit(**LAW)
def turned(cross, dot):
    d = cross / dot
    d2 = d * d
    return d * {_horner_source(ATAN_COEFFICIENTS_TO_HALF)}
"""

# For steps in which a limp string may fold: accurate up to 180 degrees.
ANY_TURN_SOURCE = f"""
@njit(**LAW)
def turned(cross, dot):
    beside = abs(cross)
    ahead = np.sqrt(cross * cross + dot * dot) + dot
    small = beside if beside < ahead else ahead
    large = ahead if beside < ahead else beside
    d = small / (large + 1e-300)
    d2 = d * d
    half = d * {_horner_source(ATAN_COEFFICIENTS_TO_ONE)}
    angle = 2.0 * half if beside < ahead else np.pi - 2.0 * half
    return angle if cross > 0.0 else -angle
"""
