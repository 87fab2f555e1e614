"""Tables of convergence for the page on the model.

Run `python -m tests.convergence.table`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path
from time import perf_counter

import numpy as np
import yaml

from stringcast.data.artifacts import JOINTS
from stringcast.known import KnownString, experiment_for_call
from stringcast.stages.generate.curves import plain_cast
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.engine.accuracy import (
    find_converged_string,
    richardson_limit,
)
from stringcast.stages.model.engine.implicit_leapfrog import ImplicitLeapfrog
from stringcast.stages.model.engine.integrators import RungeKutta4, SemiImplicitEuler
from stringcast.stages.model.engine.simulate import simulate
from stringcast.stages.model.engine.stability import steps_per_tick
from stringcast.stages.model.hand import HandMotion, JointMotion, resample_joint_motion
from stringcast.stages.model.string import String

CANDIDATES = 64  # number simulated together for the timing


def loaded(path: str) -> dict:
    with open(path) as file:
        return yaml.safe_load(file)


def specimen(letter: str) -> dict:
    return loaded(f"conf/specimen/{letter}.yaml")["parameters"]


ARM = Arm(
    **{
        k: tuple(v) if isinstance(v, list) else v
        for k, v in loaded("conf/arm/paper.yaml").items()
    }
)
A = specimen("A")
KINDS = {
    "A": A,
    "D, limp": specimen("D"),
    "A, c_s and c_h at their top": A
    | {"axial_damping": 1.3e3, "bending_damping": 0.67},
    "A, k_s and k_h at their top": A
    | {"axial_stiffness": 9e5, "bending_stiffness": 400.0},
}
CAST = plain_cast(ARM, 0.5)
HAND = JointMotion(0.0, ARM.tick, *CAST.sample(ARM.tick, 0.5)).hand_motion(ARM)
TIMES = HAND.start + HAND.tick * np.arange(HAND.pose.shape[1])
METHODS = (SemiImplicitEuler(), ImplicitLeapfrog())


def fine(points: int, **settings: object) -> String:
    return String(0.3, points, tip_cell=0.5, grasp_cell=0.5, **settings)


def tip(string: String, named: dict, hand: HandMotion = HAND) -> np.ndarray:
    times = hand.start + hand.tick * np.arange(hand.pose.shape[1])
    return simulate(string, hand, string.values(named), times).tip


def largest_tip_error_mm(string: String, named: dict, exact: np.ndarray) -> float:
    """Return the largest distance from the exact tip at any time [mm]."""
    return 1e3 * np.linalg.norm(tip(string, named) - exact, axis=-1).max()


def cost(string: String, named: dict) -> float:
    """Return the milliseconds for `CANDIDATES` strings, the best of five."""
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
                    _one(fine(points, integrator=method, largest_step=h), named, exact)
                    for h in (1e-3, 5e-4, 2e-4)
                ]
                rows.append([str(points), kind, method.name, *cells])
    return rows


def _one(string: String, named: dict, exact: np.ndarray) -> str:
    steps, possible = steps_per_tick(
        string, string.material(string.values(named)[None]), HAND.tick
    )
    if not possible[0]:
        return "impractical"
    return f"{largest_tip_error_mm(string, named, exact):.3f} ({5e3 / steps[0]:.3g} us, {cost(string, named):.0f} ms)"


def by_points() -> list[list[str]]:
    rows = []
    for kind, named in KINDS.items():
        for cells, label in ((0.0, "equal points, Eq. 1"), (0.5, "second order")):
            strings = [
                String(
                    0.3,
                    n + 1,
                    tip_cell=1 - cells,
                    grasp_cell=cells,
                    integrator=ImplicitLeapfrog(),
                )
                for n in (9, 14, 28, 56, 112)
            ]
            tips = [tip(string, named) for string in strings]
            distances = [
                1e3 * np.linalg.norm(one - tips[-1], axis=-1).max() for one in tips[:-1]
            ]
            rows.append([kind, label, *(f"{d:.2f}" for d in distances)])
    return rows


def by_tolerance() -> list[list[str]]:
    rows = []
    for kind in ("A", "D, limp"):
        exact = tip(
            fine(113, integrator=ImplicitLeapfrog(), largest_step=5e-5), KINDS[kind]
        )
        for tolerance in (0.010, 0.003):
            for method in METHODS:
                string = fine(10, integrator=method)
                found = find_converged_string(
                    string, HAND, string.values(KINDS[kind]), tolerance
                ).string
                size = [str(found.points), f"{found.largest_step * 1e6:.0f}"]
                got = [
                    f"{largest_tip_error_mm(found, KINDS[kind], exact):.2f}",
                    f"{cost(found, KINDS[kind]):.0f}",
                ]
                rows.append([kind, f"{tolerance * 1e3:.0f}", method.name, *size, *got])
    return rows


def paper_motions(letter: str) -> Iterator[HandMotion]:
    """Yield the motions that the paper's generator finds for a string.

    For each of its targets, from four seeds, these are the first motion of an
    experiment, by the smallest parameters, and one by the true parameters.
    """
    true = KnownString({"parameter_values": specimen(letter)})
    paper = yaml.safe_load(Path("conf/experiment/paper.yaml").read_text())
    variants = paper["hydra"]["launcher"]["variants"]
    for name in sorted(name for name in variants if name.startswith(f"{letter}_")):
        for seed, known in product(range(4), (None, true)):
            overrides = [o for o in variants[name] if "reference_points" not in o]
            overrides = ["+experiment=paper", *overrides, "string.reference_points=10"]
            experiment = experiment_for_call(tuple(overrides), known)
            made = experiment.stages["generate"](
                experiment.model,
                experiment.target,
                experiment.obstacles,
                None,
                None,
                seed=seed,
            )
            yield resample_joint_motion(
                made.commands["t"].to_numpy(), made.commands[list(JOINTS)].to_numpy()
            ).hand_motion(ARM)


def by_motion() -> list[list[str]]:
    motions = {letter: list(paper_motions(letter)) for letter in "ABCD"}
    exact = {
        s: [_converged(hand, specimen(s)) for hand in hands]
        for s, hands in motions.items()
    }
    rows = []
    for points, step in (
        (10, 2e-4),
        (20, 1e-3),
        (29, 5e-4),
        (40, 5e-4),
        (57, 5e-4),
        (80, 5e-4),
    ):
        string = (
            fine(points, integrator=ImplicitLeapfrog(), largest_step=step)
            if points > 10
            else String(0.3)
        )
        cells = []
        for letter, hands in motions.items():
            tips = [tip(string, specimen(letter), hand) for hand in hands]
            distances = [
                1e3 * np.linalg.norm(a - b, axis=-1)
                for a, b in zip(tips, exact[letter], strict=True)
            ]
            rms, largest = (
                [kind(each) for each in distances]
                for kind in (lambda d: np.sqrt(np.mean(d**2)), np.max)
            )
            cells.append(f"{np.median(rms):.2f} ({np.median(largest):.1f})")
        rows.append([str(points), f"{step * 1e3:g}", *cells])
    return rows


def _converged(hand: HandMotion, named: dict) -> np.ndarray:
    """Return the tip of infinitely many points."""
    meshes = (115, 1e-4), (229, 5e-5)
    return richardson_limit(
        *(
            tip(fine(n, integrator=ImplicitLeapfrog(), largest_step=h), named, hand)
            for n, h in meshes
        )
    )


def check() -> list[list[str]]:
    """Compare the reference of `by_step` with an explicit method of fourth order.

    The comparison is made only where it is practical.
    """
    rows = []
    for points, kind in ((10, "A"), (25, "A"), (25, "D, limp")):
        exact = tip(
            fine(points, integrator=RungeKutta4(), largest_step=2e-5), KINDS[kind]
        )
        implicit = replace(
            fine(points), integrator=ImplicitLeapfrog(), largest_step=1e-5
        )
        rows.append(
            [
                str(points),
                kind,
                f"{largest_tip_error_mm(implicit, KINDS[kind], exact):.5f}",
            ]
        )
    return rows


if __name__ == "__main__":
    steps = [f"{h} us" for h in (1000, 500, 200)]
    print(
        "Tip, largest distance in mm from a step of 10 us (step really taken, time for 64 candidates):\n"
    )
    table(["points", "string", "method", *(f"at most {s}" for s in steps)], by_step)
    print("That reference against Runge-Kutta 4, mm:\n")
    table(["points", "string", "apart"], check)
    print("Tip, largest distance in mm from 112 segments of the same kind:\n")
    table(["string", "lumping", "9", "14", "28", "56"], by_points)
    print(
        "Motions of the paper's experiments, tip off in mm: root mean square of the median motion (its farthest):\n"
    )
    table(["points", "step ms", *"ABCD"], by_motion)
    print(
        "Chosen by `accurate` from a tolerance; off: from 112 segments in steps of 50 us:\n"
    )
    table(
        ["string", "mm asked", "method", "points", "step us", "mm off", "ms for 64"],
        by_tolerance,
    )
