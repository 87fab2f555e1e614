"""In which numbers the step loop computes, and what that asks of its text.

`Single` is twice as many candidates in a register, with 24 bits for each number. A segment of
5 mm that is the difference of two positions half a metre away would be rounded to 1e-5 of itself;
60 points held so are 1.2 mm off after a cast. So the loop holds only what has happened since the
hand's last tick: how far a point has moved, by how much a segment has turned. Both are small
and keep their digits; each tick they are added to what they started from, positions in float64.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

WHOLE = """
@njit(**LAW)
def record(B, n, before, now, alive):
    # Positions at a tick; a lane that is no longer finite is given up.
    for i in range(n):
        for j in range(W):
            now[0, i, j] = B[X + i * NEXT + j]
            now[1, i, j] = B[Y + i * NEXT + j]
    for j in range(W):
        size = abs(B[X + (n - ONE) * NEXT + j]) + abs(B[Y + (n - ONE) * NEXT + j])
        alive[j] = alive[j] and size < 1e3
"""

SINCE_TICK = """
@njit(**LAW)
def record(B, n, before, now, alive):
    # Positions at a tick, from those at the tick before; from here on, what has happened since this one.
    for i in range(n):
        for j in range(W):
            k = i * NEXT + j
            now[0, i, j] = before[0, i, j] + B[X + k]
            now[1, i, j] = before[1, i, j] + B[Y + k]
            B[ATX + k] = now[0, i, j]
            B[ATY + k] = now[1, i, j]
    for j in range(W):
        B[KINK + j] += B[ANGLE + j] - B[HA + j]
        B[HA + j] = 0.0
    for i in range(ONE, n - ONE):
        for j in range(W):
            k = i * NEXT + j
            B[KINK + k] += B[ANGLE + k] - B[ANGLE + k - NEXT]
    for i in range(n - ONE):
        for j in range(W):
            k = i * NEXT + j
            B[DX + k] = now[0, i + ONE, j] - now[0, i, j]
            B[DY + k] = now[1, i + ONE, j] - now[1, i, j]
            # a segment's turn is known up to the last pass: where it was then, seen from this tick
            B[SX + k] -= B[X + k + NEXT] - B[X + k]
            B[SY + k] -= B[Y + k + NEXT] - B[Y + k]
            B[ANGLE + k] = 0.0
    for i in range(n):
        for j in range(W):
            B[X + i * NEXT + j] = 0.0
            B[Y + i * NEXT + j] = 0.0
    for j in range(W):
        size = abs(now[0, n - ONE, j]) + abs(now[1, n - ONE, j])
        alive[j] = alive[j] and size < 1e3
"""


@dataclass(frozen=True)
class Precision:
    """number: type of all that the loop computes with. width: candidates side by side, 128 bytes of them. rows: names
    of rows of its own. Then source text. segment: from rows to a segment (ex, ey) and its angle. kink: what
    a difference of angles lacks to be the angle between two segments. place: a point's position (atx, aty)
    in the world. record: what is done at a tick.
    """

    number: type[np.floating]
    width: int
    segment: tuple[str, ...] = field(repr=False)
    kink: str
    place: tuple[str, ...]
    record: str = field(repr=False)
    rows: tuple[str, ...] = ()

    def start(
        self, positions: np.ndarray, vectors: np.ndarray, angles: np.ndarray, theta: np.ndarray
    ) -> Mapping[str, np.ndarray]:
        """First values of the rows that hold the shape, (C, n or n - 1) each.

        positions: (C, n, 2) of the points [m]. vectors: (C, n - 1, 2) along the segments [m], and their angles,
        (C, n - 1) [rad]. theta: (1 or C,) direction of the hand [rad].
        """
        raise NotImplementedError

    def hand(self, cubic: np.ndarray) -> np.ndarray:
        """The hand's motion as the loop takes it. cubic: (K, 12, C), for x, y, theta each a0 to a3."""
        raise NotImplementedError

    def text(self, module: str) -> str:
        """The module's text in these numbers."""
        raise NotImplementedError


@dataclass(frozen=True)
class Double(Precision):
    """float64, and everything as it lies in the world."""

    number: type[np.floating] = np.float64
    width: int = 16
    segment: tuple[str, ...] = (
        "ex = B[X + k + NEXT] - B[X + k]",
        "ey = B[Y + k + NEXT] - B[Y + k]",
        "angle = B[ANGLE + k] + turned(B[SX + k] * ey - B[SY + k] * ex, B[SX + k] * ex + B[SY + k] * ey)",
        "B[SX + k] = ex",
        "B[SY + k] = ey",
    )
    kink: str = ""
    place: tuple[str, ...] = ("atx = px", "aty = py")
    record: str = field(default=WHOLE, repr=False)

    def start(
        self, positions: np.ndarray, vectors: np.ndarray, angles: np.ndarray, theta: np.ndarray
    ) -> Mapping[str, np.ndarray]:
        """Where everything is."""
        return {
            **{"X": positions[..., 0], "Y": positions[..., 1], "ANGLE": angles},
            **{"SX": vectors[..., 0], "SY": vectors[..., 1]},
        }

    def hand(self, cubic: np.ndarray) -> np.ndarray:
        """As it is."""
        return cubic

    def text(self, module: str) -> str:
        """As it is: a literal is a float64 already."""
        return module


@dataclass(frozen=True)
class Single(Precision):
    """float32, and everything as it has changed since the tick."""

    number: type[np.floating] = np.float32
    width: int = 32
    rows: tuple[str, ...] = ("DX", "DY", "KINK", "ATX", "ATY")
    # The turn from how the segment has changed since the last pass, (cx, cy): the cross product of before and
    # after would be the difference of two nearly equal products, and its rounding as large as small turns.
    segment: tuple[str, ...] = (
        "gx = B[X + k + NEXT] - B[X + k]",
        "gy = B[Y + k + NEXT] - B[Y + k]",
        "ex = B[DX + k] + gx",
        "ey = B[DY + k] + gy",
        "cx = gx - B[SX + k]",
        "cy = gy - B[SY + k]",
        "angle = B[ANGLE + k] + turned(ex * cy - ey * cx, ex * (ex - cx) + ey * (ey - cy))",
        "B[SX + k] = gx",
        "B[SY + k] = gy",
    )
    kink: str = " + B[KINK + k]"
    place: tuple[str, ...] = ("atx = B[ATX + p] + px", "aty = B[ATY + p] + py")
    record: str = field(default=SINCE_TICK, repr=False)

    def start(
        self, positions: np.ndarray, vectors: np.ndarray, angles: np.ndarray, theta: np.ndarray
    ) -> Mapping[str, np.ndarray]:
        """Nothing has changed yet; the kinks are what they are."""
        kinks = np.diff(angles, axis=1, prepend=0.0)
        kinks[:, 0] -= theta
        return {"KINK": kinks}

    def hand(self, cubic: np.ndarray) -> np.ndarray:
        """From the tick on: without a0."""
        return np.where(np.arange(12)[:, None] % 4, cubic, 0.0).astype(self.number)

    def text(self, module: str) -> str:
        """With every literal and constant cast, since one float64 draws all that it meets along."""
        return ast.unparse(_Cast().visit(ast.parse(module))) + "\n"


class _Cast(ast.NodeTransformer):
    """Wraps literals such as 9.81 and constants such as np.pi in `number(...)`."""

    def visit_Constant(self, node: ast.Constant) -> ast.expr:
        return _number(node) if isinstance(node.value, float) else node

    def visit_Attribute(self, node: ast.Attribute) -> ast.expr:
        constant = isinstance(node.value, ast.Name) and node.value.id == "np" and isinstance(_of(node.attr), float)
        return _number(node) if constant else node


def _of(name: str) -> object:
    return getattr(np, name, None)


def _number(node: ast.expr) -> ast.expr:
    return ast.Call(ast.Name("number", ast.Load()), [node], [])
