"""The angle by which a segment turns in a step, as source text for the kernel.

`turned(cross, dot)` [rad] from the cross and dot products of a segment before and after.
"""

from __future__ import annotations

import numpy as np


def coefficients(degree: int = 8, limit: float = 0.5) -> np.ndarray:
    """Coefficients a_k of atan(d) = d * sum a_k d^(2k), fitted for |d| <= limit."""
    nodes = np.polynomial.chebyshev.chebpts1(200)
    d2 = (nodes + 1.0) / 2.0 * limit**2
    d = np.sqrt(d2)
    return np.polynomial.polynomial.polyfit(d2, np.arctan(d) / d, degree - 1)


def arc_tangent(degree: int, limit: float) -> str:
    """Polynomial in d2 = d^2 that approximates atan(d) / d for |d| <= limit, as text."""
    *lower, text = (repr(float(c)) for c in coefficients(degree, limit))
    for coefficient in reversed(lower):
        text = f"({coefficient} + d2 * {text})"
    return text


# For small steps: relative error 1e-10 up to 26 degrees; no sense from 90 on.
SMALL = f"""
@njit(**LAW)
def turned(cross, dot):
    d = cross / dot
    d2 = d * d
    return d * {arc_tangent(8, 0.5)}
"""

# For steps in which a limp string may fold: relative error 1e-10 up to 180 degrees.
ANY = f"""
@njit(**LAW)
def turned(cross, dot):
    beside = abs(cross)
    ahead = np.sqrt(cross * cross + dot * dot) + dot
    d = (beside if beside < ahead else ahead) / ((ahead if beside < ahead else beside) + 1e-300)
    d2 = d * d
    half = d * {arc_tangent(12, 1.0)}
    angle = 2.0 * half if beside < ahead else np.pi - 2.0 * half
    return angle if cross > 0.0 else -angle
"""
