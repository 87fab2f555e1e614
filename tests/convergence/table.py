"""Prints the tables of convergence of stages/model/README.md: `python -m tests.convergence.table`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from time import perf_counter

import numpy as np
import yaml

from stringcast.stages.generate.curves import plain_cast
from stringcast.stages.model.accuracy import accurate
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.hand import JointMotion
from stringcast.stages.model.implicit import ImplicitLeapfrog
from stringcast.stages.model.integrator import RungeKutta4, SemiImplicitEuler
from stringcast.stages.model.simulate import simulate
from stringcast.stages.model.stability import steps_per_tick
from stringcast.stages.model.string import String

CANDIDATES = 64  # simulated side by side when time is taken


def loaded(path: str) -> dict:
    with open(path) as file:
        return yaml.safe_load(file)


ARM = Arm(**{k: tuple(v) if isinstance(v, list) else v for k, v in loaded("conf/arm/paper.yaml").items()})
A = loaded("conf/specimen/A.yaml")["parameters"]
KINDS = {
    "A": A,
    "D, limp": loaded("conf/specimen/D.yaml")["parameters"],
    "A, c_s and c_h at their top": A | {"axial_damping": 1.3e3, "bending_damping": 0.67},
    "A, k_s and k_h at their top": A | {"axial_stiffness": 9e5, "bending_stiffness": 400.0},
}
CAST = plain_cast(ARM, 0.5)
HAND = JointMotion(0.0, ARM.tick, *CAST.sampled(ARM.tick, 0.5)).grasp(ARM)
TIMES = HAND.start + HAND.tick * np.arange(HAND.pose.shape[1])
METHODS = (SemiImplicitEuler(), ImplicitLeapfrog())


def fine(points: int, **settings: object) -> String:
    return String(0.3, points, tip_cell=0.5, grasp_cell=0.5, **settings)


def tip(string: String, named: dict) -> np.ndarray:
    return simulate(string, HAND, string.values(named), TIMES).tip


def off(string: String, named: dict, exact: np.ndarray) -> float:
    """Largest distance from the exact tip at any time [mm]."""
    return 1e3 * np.linalg.norm(tip(string, named) - exact, axis=-1).max()


def cost(string: String, named: dict) -> float:
    """Milliseconds for `CANDIDATES` strings, the best of five."""
    values = np.repeat(string.values(named)[None], CANDIDATES, axis=0)

    def once() -> float:
        start = perf_counter()
        simulate(string, HAND, values, TIMES)
        return perf_counter() - start

    return 1e3 * min(once() for _ in range(5))


def table(head: list[str], rows: Callable[[], list[list[str]]]) -> None:
    print("| " + " | ".join(head) + " |\n|" + " --- |" * len(head))
    for row in rows():
        print("| " + " | ".join(row) + " |")
    print()


def by_step() -> list[list[str]]:
    rows = []
    for points in (10, 25, 60):
        for kind, named in KINDS.items():
            reference = fine(points, integrator=ImplicitLeapfrog(), largest_step=1e-5)
            exact = tip(reference, named)
            for method in METHODS:
                cells = [
                    _one(fine(points, integrator=method, largest_step=h), named, exact) for h in (1e-3, 5e-4, 2e-4)
                ]
                rows.append([str(points), kind, method.name, *cells])
    return rows


def _one(string: String, named: dict, exact: np.ndarray) -> str:
    steps, possible = steps_per_tick(string, string.material(string.values(named)[None]), HAND.tick)
    if not possible[0]:
        return "impractical"
    return f"{off(string, named, exact):.3f} ({5e3 / steps[0]:.3g} us, {cost(string, named):.0f} ms)"


def by_points() -> list[list[str]]:
    rows = []
    for kind, named in KINDS.items():
        for cells, label in ((0.0, "equal points, Eq. 1"), (0.5, "second order")):
            strings = [
                String(0.3, n + 1, tip_cell=1 - cells, grasp_cell=cells, integrator=ImplicitLeapfrog())
                for n in (9, 14, 28, 56, 112)
            ]
            tips = [tip(string, named) for string in strings]
            apart = [1e3 * np.linalg.norm(one - tips[-1], axis=-1).max() for one in tips[:-1]]
            rows.append([kind, label, *(f"{d:.2f}" for d in apart)])
    return rows


def by_tolerance() -> list[list[str]]:
    rows = []
    for kind in ("A", "D, limp"):
        exact = tip(fine(113, integrator=ImplicitLeapfrog(), largest_step=5e-5), KINDS[kind])
        for tolerance in (0.010, 0.003):
            for method in METHODS:
                string = fine(10, integrator=method)
                found = accurate(string, HAND, string.values(KINDS[kind]), tolerance).string
                size = [str(found.points), f"{found.largest_step * 1e6:.0f}"]
                got = [f"{off(found, KINDS[kind], exact):.2f}", f"{cost(found, KINDS[kind]):.0f}"]
                rows.append([kind, f"{tolerance * 1e3:.0f}", method.name, *size, *got])
    return rows


def check() -> list[list[str]]:
    """The reference of `by_step` against an explicit method of fourth order, where that is practical."""
    rows = []
    for points, kind in ((10, "A"), (25, "A"), (25, "D, limp")):
        exact = tip(fine(points, integrator=RungeKutta4(), largest_step=2e-5), KINDS[kind])
        mine = replace(fine(points), integrator=ImplicitLeapfrog(), largest_step=1e-5)
        rows.append([str(points), kind, f"{off(mine, KINDS[kind], exact):.5f}"])
    return rows


if __name__ == "__main__":
    steps = [f"{h} us" for h in (1000, 500, 200)]
    print("Tip, largest distance in mm from a step of 10 us (step really taken, time for 64 candidates):\n")
    table(["points", "string", "method", *(f"at most {s}" for s in steps)], by_step)
    print("That reference against Runge-Kutta 4, mm:\n")
    table(["points", "string", "apart"], check)
    print("Tip, largest distance in mm from 112 segments of the same kind:\n")
    table(["string", "lumping", "9", "14", "28", "56"], by_points)
    print("Chosen by `accurate` from a tolerance; off: from 112 segments in steps of 50 us:\n")
    table(["string", "mm asked", "method", "points", "step us", "mm off", "ms for 64"], by_tolerance)
