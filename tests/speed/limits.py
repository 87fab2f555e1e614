"""What this machine can do at best, and what one mass-point-step asks of it.

Two limits, both measured in float64 on one core: the vector units' peak (chains of
fused multiply-adds, enough of them to hide their latency) and the unit that divides and
takes square roots, which works beside the others. No loop can be faster than the slower
of the two on the arithmetic that it does.
"""

from __future__ import annotations

import ast
from collections import Counter
from dataclasses import dataclass

import numpy as np
from numba import njit

from tests.speed.stopwatch import seconds

CHAINS = 256  # numbers worked on side by side
LINKS = 32  # operations on each
REPEATS = 2000
SMALL = (ast.Add, ast.Sub, ast.Mult)

multiply_add = "x = x * 0.999999 + 1e-7"
divide = "x = 1.5 / x"
square_root = "x = np.sqrt(x + 1.0)"


@dataclass(frozen=True)
class Limits:
    """Seconds on one core for each: `small` addition or multiplication, division,
    square root.
    """

    small: float
    division: float
    root: float

    def of(self, work: Counter[str]) -> float:
        """The least time for this work [s]: the slower of the two limits."""
        slow = work["division"] * self.division + work["root"] * self.root
        return max(work["small"] * self.small, slow)


def measured() -> Limits:
    """The limits of this machine, now."""
    return Limits(_each(multiply_add) / 2, _each(divide), _each(square_root))


def _each(operation: str) -> float:
    """Seconds for one operation, at best."""
    text = "def run(a, repeats):\n for _ in range(repeats):\n  for j in range(a.size):\n   x = a[j]\n"
    text += f"   {operation}\n" * LINKS + "   a[j] = x\n"
    made: dict[str, object] = {"np": np}
    exec(text, made)
    run = njit(error_model="numpy", fastmath={"contract"})(made["run"])
    numbers = np.linspace(1.0, 2.0, CHAINS)
    run(numbers, 1)
    return min(seconds(lambda: run(numbers, REPEATS)) for _ in range(5)) / (
        CHAINS * LINKS * REPEATS
    )


def work(module: str) -> Counter[str]:
    """Arithmetic of one mass-point-step in the text of a generated module.

    Counted as written in the loop over the inner points, laws included: additions,
    subtractions and multiplications as `small`, divisions, square roots. Indices are
    not arithmetic, nor are multiplications by 1 and sums with 0, which the compiler
    drops.
    """
    functions = {
        f.name: f for f in ast.parse(module).body if isinstance(f, ast.FunctionDef)
    }
    loops = (node for node in ast.walk(functions["run"]) if isinstance(node, ast.For))
    points = next(
        loop for loop in loops if ast.unparse(loop.iter) == "range(TWO, n - ONE)"
    )
    lanes = next(n for n in points.body if isinstance(n, ast.For))
    count: Counter[str] = Counter()
    for statement in lanes.body[2:]:  # the first two are the row's indices
        _count(statement, functions, count)
    return count


def _count(
    node: ast.AST, functions: dict[str, ast.FunctionDef], count: Counter[str]
) -> None:
    """Add the arithmetic under a node."""
    if isinstance(node, ast.Subscript):
        return
    if isinstance(node, (ast.BinOp, ast.AugAssign)) and not _nothing(node):
        count["small" if isinstance(node.op, SMALL) else "division"] += 1
    if isinstance(node, ast.Call):
        name = ast.unparse(node.func)
        count["root"] += name == "np.sqrt"
        if name in functions:
            _count(functions[name], functions, count)
    for child in ast.iter_child_nodes(node):
        _count(child, functions, count)


def _nothing(node: ast.BinOp | ast.AugAssign) -> bool:
    """Whether it is x + 0, x - 0 or 1 * x, of literal numbers."""
    sides = (node.left, node.right) if isinstance(node, ast.BinOp) else (node.value,)
    idle = 1.0 if isinstance(node.op, ast.Mult) else 0.0
    return any(isinstance(side, ast.Constant) and side.value == idle for side in sides)
