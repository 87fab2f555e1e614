"""The step loop, fused for one set of effects.

`kernel_for` writes a module that holds the laws of the effects, word for word, and one
loop around them, and lets Numba compile it (`generated`). What is not given is not in
the text, and costs nothing; which are given `String.in_loop` says. Text, because Numba
finds machine code of a text again in the next process, and that of a loop over
functions never (README.md); `python -m stringcast.stages.model.engine.print_loop
[EFFECT ...]` prints it.

Layout: W candidates side by side. Every quantity of a mass point or a segment is a row
of W numbers; the innermost loop runs over the row, branch-free, so that LLVM fills the
vector units. It does so only where it sees that rows do not overlap: all rows lie in
one buffer B at distances known at compile time, and even what is needed only once (a
segment's tension, say) has a row for each segment. The rows of a point lie together,
and so spread evenly over the sets of the first cache. Indices are unsigned, so that
none can be negative.

Each pass goes along the string once, a segment ahead of the point it moves: segment i +
1 needs points i + 1 and i + 2 as they were, point i + 1 needs the forces of segments i
and i + 1. Segment angles are continuous: each pass adds the angle by which the segment
has turned since the last, so that hinges may wind through +-pi.

A candidate alone would leave all lanes but one idle: W = 1 makes of the same text a
scalar loop, which takes half the time of sixteen lanes, with the paper's forces to the
same bits. To compile it takes as long as a thousand runs save, so it is compiled after
these (`lanes`).

What is done in one lane is a function, typed and lowered once and inlined wherever it
is called. Loops over lanes stand in `run` alone: a function with loops would be
optimised and translated by itself, and again where it is inlined.
"""

from __future__ import annotations

import inspect
import math
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import count, repeat
from typing import Any

import numpy as np

from stringcast.stages.model.effect import StringEffect
from stringcast.stages.model.engine.integrators import Integrator
from stringcast.stages.model.engine.law_slots import (
    FREE_LENGTH_ROWS,
    MEMORY_SLOTS,
    PROPORTIONAL_SLOTS,
    law_arguments,
)
from stringcast.stages.model.engine.module_cache import (
    import_generated_module,
    module_path,
)
from stringcast.stages.model.engine.threads import parallel_for
from stringcast.stages.model.string import PAPER_EFFECTS

LANES = 16  # candidates side by side: 128 bytes of each quantity, two cache lines
# runs of one candidate after which a loop for it pays: 0.4 to 3 ms saved each, 1.5 to
# 2.6 s to compile
RUNS_BEFORE_SINGLE_LANE = 1000
# points after the tip that nothing is written to, for what looks further than the
# string goes
PADDING_POINTS = 2

POINT_ROWS = (
    *("X", "Y", "VX", "VY", "ANGLE", "SX", "SY", "INERTIA", "WEIGHT"),
    *("TX", "TY", "INVERSE", "PULL", "OMEGA", "MOMENT", "FX", "FY"),
    *("HA", "HW", "SET"),
)  # and after them those of the integrator

# What a law's argument is in the text of the loop.
ARGUMENT_EXPRESSIONS = {
    "tension": {"stretch": "stretch", "rate": "rate", "s": "s_middle<<longer>>"},
    "moment": {"curvature": "curvature", "rate": "bend", "s": "s_hinge<<longer>>"},
    "held": {"change": "change", "dt": "lapse"},
    "held_moment": {},
    "grasp_held": {"change": "change", "dt": "lapse"},
    "grasp_held_moment": {},
    "hinge_stiffness": {},
    "grasp_moment": {"angle": "curvature", "rate": "bend"},
    "load": {
        **{
            "x": "px",
            "y": "py",
            "vx": "qx",
            "vy": "qy",
            "ux": "(qx - airx)",
            "uy": "(qy - airy)",
        },
        **{"tx": "lx", "ty": "ly", "s": "s_point<<longer>>", "t": "t", "dt": "dt"},
    },
    "acceleration": {"x": "px", "y": "py", "t": "t"},
    "flow": {"x": "px", "y": "py", "t": "t"},
    "rest_curvature": {
        "s": "s_hinge<<longer>>",
        "length": "(float(n) - 1.0) * length<<longer>>",
    },
}

StepLoop = Callable[..., None]


@cache
def compile_step_loop(
    effects: tuple[type[StringEffect], ...],
    names: tuple[str, ...],
    integrator: Integrator,
    width: int = LANES,
) -> StepLoop:
    """The compiled step loop for these effects.

    names: of the rows of parameters, as `String.rows`. width: candidates side by side.
    Returns `run(buffers, P, H, ...)`, see the generated text, for all blocks, on as
    many threads as Numba is set to use.
    """
    some = import_generated_module(
        generate_source(effects, names, integrator, width)
    ).run

    def run(buffers: np.ndarray, **given: Any) -> None:
        parallel_for(
            lambda first, last: some(first, last, buffers, **given), len(buffers)
        )

    return run


def lane_count(
    candidates: int,
    effects: tuple[type[StringEffect], ...],
    names: tuple[str, ...],
    integrator: Integrator,
) -> int:
    """The number of candidates side by side in the loop for so many: one for one alone,
    once it pays to compile that or where it was compiled before.
    """
    return (
        1
        if candidates == 1
        and next(_single_lane_runs(effects, names, integrator))
        >= RUNS_BEFORE_SINGLE_LANE
        else LANES
    )


@cache
def _single_lane_runs(
    effects: tuple[type[StringEffect], ...],
    names: tuple[str, ...],
    integrator: Integrator,
) -> Iterator[int]:
    """Counts the runs of one candidate alone: as if there had been enough where their
    loop is there already, and none for more than the paper's forces, some of whose sums
    the compiler rounds otherwise in one lane.
    """
    if effects != PAPER_EFFECTS:
        return repeat(-1)
    return count(
        RUNS_BEFORE_SINGLE_LANE
        if module_path(generate_source(effects, names, integrator, 1)).exists()
        else 0
    )


def generate_source(
    effects: Sequence[type[StringEffect]],
    names: Sequence[str],
    integrator: Integrator,
    width: int = LANES,
) -> str:
    """The module's text: TEMPLATE with the laws, and with calls of them in its places
    `<<...>>`.
    """
    laws = LawSource(effects, names)
    longer, over = (
        laws.parameter(name) if name in names else "" for name in FREE_LENGTH_ROWS
    )
    heavy = any(
        {"density", "tip_mass", "tip_length"} & e.laws().keys() for e in effects
    )
    fill = {
        "constants": "\n".join(
            f"{name} = np.uintp({value})"
            for name, value in _row_offsets(integrator, effects, width)
        ),
        "laws": "\n\n\n".join(
            laws.definition(e, slot)
            for slot in ARGUMENT_EXPRESSIONS
            for e in laws.effects_with(slot)
        ),
        "W": str(width),
        "nodes": repr(tuple(map(float, integrator.stage_times))),
        "turned": integrator.turn_source,
        "over": f"over = {over}" if over else "",
        "tension": laws.sum_of_laws("tension"),
        "rest": laws.sum_of_laws("rest_curvature"),
        "set": "B[SET + j]" if laws.effects_with("rest_curvature") else "0.0",
        **_moment_source(laws, integrator),
        **{
            slot: laws.vector_sum(slot, name)
            for slot, name in (
                ("flow", "air"),
                ("load", "load"),
                ("acceleration", "fall"),
            )
        },
        "weight": "B[WEIGHT + p]" if heavy else "1.0",
        "velocity": "\n".join(integrator.velocity_source),
        "update": "\n".join(integrator.update_source),
        "solve": integrator.solve_source,
    }
    # where the string is longer than stated, arc lengths in arguments of laws are, too
    return _fill_template(TEMPLATE, fill).replace(
        "<<longer>>", f" * {longer}" if longer else ""
    )


def _row_offsets(
    integrator: Integrator, effects: Sequence[type[StringEffect]], width: int
) -> Iterator[tuple[str, int]]:
    """Distances in a buffer: of a point's rows from its first, of the next point, and
    of the grasp's coefficients.
    """
    numbers = row_numbers(integrator, effects)
    yield from ((name, number * width) for name, number in numbers.items())
    yield "NEXT", len(numbers) * width
    yield from ((f"H{i}", i * width) for i in range(12))


def _moment_source(laws: LawSource, integrator: Integrator) -> dict[str, str]:
    """The template's places in the hinges and in the grasp: laws per curvature or rate,
    memory, and moments.
    """
    per = {
        slot: ARGUMENT_EXPRESSIONS[other][argument]
        for slot, (other, argument) in PROPORTIONAL_SLOTS.items()
        if laws.effects_with(slot)
    }

    def at(slot: str, argument: str) -> str:
        return laws.sum_of_laws(slot, {PROPORTIONAL_SLOTS[slot][1]: argument})

    stiff = [f"{slot} * {factor}" for slot, factor in per.items()]
    steps = [f"{slot} = {at(slot, factor)}" for slot, factor in per.items()]
    passes = len(integrator.stage_times)
    return {
        "per": "\n".join([*steps, *integrator.hinge_source(list(per), at)]),
        **{
            slot: "\n".join(laws.memory_update(slot, passes))
            for slot, _, _ in MEMORY_SLOTS.values()
        },
        "moment": " + ".join(
            [laws.sum_of_laws("moment"), *stiff, *laws.memory_moments("held")]
        ),
        "grasp_moment": " + ".join(
            [laws.sum_of_laws("grasp_moment"), *laws.memory_moments("grasp_held")]
        ),
    }


@dataclass(frozen=True)
class LawSource:
    """The laws of some effects as text of the loop. names: of the rows of parameters P."""

    effects: Sequence[type[StringEffect]]
    row_names: Sequence[str]

    def effects_with(self, slot: str) -> list[type[StringEffect]]:
        """The effects with a law in a slot."""
        return [effect for effect in self.effects if slot in effect.laws()]

    def definition(self, effect: type[StringEffect], slot: str) -> str:
        """The law word for word, as a function of its own."""
        lines = textwrap.dedent(inspect.getsource(effect.laws()[slot])).splitlines()
        start = next(i for i, line in enumerate(lines) if line.startswith("def "))
        body = "\n".join(lines[start:]).replace(
            f"def {slot}(", f"def {effect.name}_{slot}(", 1
        )
        return f"@njit(**LAW)\n{body}"

    def parameter(self, name: str) -> str:
        """A parameter, in the lane's candidate."""
        return f"P[np.uintp({list(self.row_names).index(name)}) * W + j]"

    def call(
        self, effect: type[StringEffect], slot: str, more: Mapping[str, str]
    ) -> str:
        """The law called with its arguments: those of the slot by name, and parameters,
        its own before the paper's.
        """
        known = {**ARGUMENT_EXPRESSIONS[slot], **more}
        given = []
        for argument in law_arguments(effect.laws()[slot]):
            rows = [
                name
                for name in (f"{effect.name}.{argument}", argument)
                if name in self.row_names
            ]
            if argument not in known and not rows:
                there = ", ".join(self.row_names)
                raise TypeError(
                    f"effect '{effect.name}': no parameter '{argument}'; there are {there}"
                )
            given.append(known.get(argument) or self.parameter(rows[0]))
        return f"{effect.name}_{slot}({', '.join(given)})"

    def sum_of_laws(self, slot: str, more: Mapping[str, str] | None = None) -> str:
        """The sum of all laws of a slot."""
        return (
            " + ".join(
                self.call(effect, slot, more or {})
                for effect in self.effects_with(slot)
            )
            or "0.0"
        )

    def vector_sum(self, slot: str, name: str) -> str:
        """The x and y that all laws of a slot add, under this name."""
        calls = [
            f"{name}{i}x, {name}{i}y = {self.call(e, slot, {})}"
            for i, e in enumerate(self.effects_with(slot))
        ]
        total = [
            f"{name}{c} = "
            + (" + ".join(f"{name}{i}{c}" for i in range(len(calls))) or "0.0")
            for c in "xy"
        ]
        return "\n".join([*calls, *total])

    def memory_update(self, slot: str, passes: int) -> Iterator[str]:
        """The update of what a hinge holds: it is kept with the first pass of a step,
        of which the others are rehearsals.
        """
        if not self.effects_with(slot):
            return
        kept = "{new}" if passes == 1 else "{new} if stage == 0 else {old}"
        yield "change = curvature - B[CURVED + k]"
        yield (
            "lapse = dt"
            if passes == 1
            else "lapse = dt if stage == 0 else dt * NODES[stage]"
        )
        for i, effect in enumerate(self.effects_with(slot)):
            yield f"held_{i} = {self.call(effect, slot, {'held': f'B[HELD{i} + k]'})}"
            yield f"B[HELD{i} + k] = {kept.format(new=f'held_{i}', old=f'B[HELD{i} + k]')}"
        yield f"B[CURVED + k] = {kept.format(new='curvature', old='B[CURVED + k]')}"

    def memory_moments(self, slot: str) -> list[str]:
        """Expressions of the moments of what hinges or the grasp hold."""
        return [
            self.call(e, f"{slot}_moment", {"held": f"held_{i}"})
            for i, e in enumerate(self.effects_with(slot))
        ]


def row_numbers(
    integrator: Integrator, effects: Sequence[type[StringEffect]]
) -> dict[str, int]:
    """Numbers of a point's rows by name; the last are those of laws with memory: the
    hinge's last curvature, and what each effect holds.
    """
    holding = max(
        sum(slot in e.laws() for e in effects) for slot, _, _ in MEMORY_SLOTS.values()
    )
    memory = ("CURVED", *(f"HELD{i}" for i in range(holding))) if holding else ()
    return {
        name: number
        for number, name in enumerate((*POINT_ROWS, *integrator.row_names, *memory))
    }


def zero_buffers(
    blocks: int,
    points: int,
    integrator: Integrator,
    effects: Sequence[type[StringEffect]],
    width: int,
) -> np.ndarray:
    """Zeros for the rows of every point, (blocks, points + BEYOND, kinds, width)."""
    return aligned_zeros(
        (blocks, points + PADDING_POINTS, len(row_numbers(integrator, effects)), width)
    )


def aligned_zeros(shape: tuple[int, ...]) -> np.ndarray:
    """Zeros whose first number begins a cache line.

    numpy aligns to 16 bytes only; a vector of 64 that crosses a line is read and
    written twice.
    """
    line = 64
    size = np.dtype(np.float64).itemsize * math.prod(shape)
    memory = np.zeros(size + line, dtype=np.uint8)
    first = -memory.ctypes.data % line
    return memory[first : first + size].view(np.float64).reshape(shape)


def _fill_template(template: str, values: dict[str, str]) -> str:
    """Put the values in their places `<<name>>`, keeping the indentation of the place."""
    lines = []
    for line in template.splitlines():
        stripped = line.strip()
        name = stripped[2:-2]
        if stripped.startswith("<<") and stripped.endswith(">>") and name in values:
            lines.append(
                textwrap.indent(values[name], line[: len(line) - len(line.lstrip())])
            )
            continue
        for key, value in values.items():
            line = line.replace(f"<<{key}>>", value)  # noqa: PLW2901
        lines.append(line)
    return "\n".join(lines) + "\n"


TEMPLATE = """\"\"\"Generated by stages.model.engine.kernel_codegen. Not to be edited.\"\"\"
from __future__ import annotations

import numpy as np
from numba import njit

BARE = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}  # nothing but this module calls what is inlined
LAW = {"error_model": "numpy", "fastmath": {"contract"}, "boundscheck": False, "forceinline": True, **BARE}
NODES = <<nodes>>
W = np.uintp(<<W>>)
ONE = np.uintp(1)
TWO = np.uintp(2)
<<constants>>


<<laws>>

<<turned>>

@njit(**LAW)
def grasp(B, H, j, u, tick):
    # Pose and rate of the grasp at fraction u of a tick, from the tick's cubic coefficients H (12 rows).
    x1, x2, x3 = H[H1 + j], H[H2 + j], H[H3 + j]
    y1, y2, y3 = H[H5 + j], H[H6 + j], H[H7 + j]
    a1, a2, a3 = H[H9 + j], H[H10 + j], H[H11 + j]
    B[X + j] = H[j] + u * (x1 + u * (x2 + u * x3))
    B[Y + j] = H[H4 + j] + u * (y1 + u * (y2 + u * y3))
    B[HA + j] = H[H8 + j] + u * (a1 + u * (a2 + u * a3))
    B[VX + j] = (x1 + u * (2.0 * x2 + 3.0 * u * x3)) / tick
    B[VY + j] = (y1 + u * (2.0 * y2 + 3.0 * u * y3)) / tick
    B[HW + j] = (a1 + u * (2.0 * a2 + 3.0 * u * a3)) / tick


# The parts of a pass: k is the row of the segment that is measured, p = k - NEXT that of the
# segment whose forces are then known, and of the point at its start, which then moves.
@njit(**LAW)
def segment(B, P, j, k, over, s_middle):
    <<over>>
    ex = B[X + k + NEXT] - B[X + k]
    ey = B[Y + k + NEXT] - B[Y + k]
    angle = B[ANGLE + k] + turned(B[SX + k] * ey - B[SY + k] * ex, B[SX + k] * ex + B[SY + k] * ey)
    B[SX + k] = ex
    B[SY + k] = ey
    wx = B[VX + k + NEXT] - B[VX + k]
    wy = B[VY + k + NEXT] - B[VY + k]
    size = np.sqrt(ex * ex + ey * ey)
    inverse = 1.0 / size
    tx = ex * inverse
    ty = ey * inverse
    omega = (tx * wy - ty * wx) * inverse
    stretch = size * over - 1.0
    rate = (tx * wx + ty * wy) * over
    B[ANGLE + k] = angle
    B[TX + k] = tx
    B[TY + k] = ty
    B[INVERSE + k] = inverse
    B[OMEGA + k] = omega
    B[PULL + k] = <<tension>>
    return angle, omega


@njit(**LAW)
def grasped(B, P, j, k, angle, omega, dt, stage):
    curvature = angle - B[HA + j] - <<set>>
    bend = omega - B[HW + j]
    <<grasp_held>>
    B[MOMENT + k] = <<grasp_moment>>


@njit(**LAW)
def hinge(B, P, j, k, p, angle, omega, n, length, over, s_hinge, dt, stage):
    <<over>>
    curvature = (angle - B[ANGLE + p]) * over - (<<rest>>)
    bend = (omega - B[OMEGA + p]) * over
    <<held>>
    <<per>>
    couple = <<moment>>
    B[MOMENT + k] = couple
    return couple


@njit(**LAW)
def force(B, p, couple):
    twist = (couple - B[MOMENT + p]) * B[INVERSE + p]
    fx = -B[PULL + p] * B[TX + p] - twist * B[TY + p]
    fy = -B[PULL + p] * B[TY + p] + twist * B[TX + p]
    B[FX + p] = fx
    B[FY + p] = fy
    return fx, fy


@njit(**LAW)
def point(B, P, j, p, fx, fy, s_point, dt, t, stage):
    px = B[X + p]
    py = B[Y + p]
    <<velocity>>
    lx = 0.5 * (B[TX + p - NEXT] + B[TX + p])
    ly = 0.5 * (B[TY + p - NEXT] + B[TY + p])
    <<flow>>
    <<load>>
    <<acceleration>>
    ax = (B[FX + p - NEXT] - fx) * B[INERTIA + p] + <<weight>> * loadx + fallx
    ay = (B[FY + p - NEXT] - fy) * B[INERTIA + p] + <<weight>> * loady + fally
    <<update>>
    B[X + p] = px
    B[Y + p] = py
    B[VX + p] = qx
    B[VY + p] = qy


@njit(**LAW)
def record(B, n, first, k, out, alive):
    # Positions at tick k of the candidates from the first on, as many as there are; a lane that is no longer finite is
    # given up. Whether any is left.
    for j in range(W):
        if first + j < np.uintp(out.shape[0]):
            for i in range(n):
                out[first + j, k, i, 0] = B[X + i * NEXT + j]
                out[first + j, k, i, 1] = B[Y + i * NEXT + j]
    some = False
    for j in range(W):
        size = abs(B[X + (n - ONE) * NEXT + j]) + abs(B[Y + (n - ONE) * NEXT + j])
        alive[j] = alive[j] and size < 1e3
        some |= alive[j]
    return some


@njit(nogil=True, error_model="numpy", fastmath={"contract"}, boundscheck=False, cache=True)
def run(first, last, buffers, P, H, per_block, points, length, steps, tick, start, out, alive):
    # Blocks first to last - 1. buffers (blocks, size), P (blocks, parameters * W), H (ticks, blocks or 1, 12 * W),
    # steps (blocks,) in a tick, out (candidates, ticks + 1, n, 2), alive (blocks, W).
    for b in range(first, last):
        B = buffers[b]
        own = P[b]
        n = np.uintp(points)
        dt = tick / steps[b]
        over = 1.0 / length
        candidate = np.uintp(b) * W
        record(B, n, candidate, 0, out, alive[b])
        for c in range(H.shape[0]):
            hand = H[c, b * per_block]
            for q in range(steps[b]):
                for stage in range(len(NODES)):
                    u = (q + NODES[stage]) / steps[b]
                    t = start + (c + u) * tick
                    for j in range(W):
                        grasp(B, hand, j, u, tick)
                    # One pass: from the grasp to the tip, moving each point once both its segments are known.
                    for j in range(W):
                        angle, omega = segment(B, own, j, j, over, 0.5 * length)
                        grasped(B, own, j, j, angle, omega, dt, stage)
                    for j in range(W):
                        k = NEXT + j
                        angle, omega = segment(B, own, j, k, over, 1.5 * length)
                        force(B, j, hinge(B, own, j, k, j, angle, omega, n, length, over, length, dt, stage))
                    for i in range(TWO, n - ONE):
                        s_middle = (float(i) + 0.5) * length
                        s_hinge = float(i) * length
                        s_point = (float(i) - 1.0) * length
                        for j in range(W):
                            k = i * NEXT + j
                            p = k - NEXT
                            angle, omega = segment(B, own, j, k, over, s_middle)
                            couple = hinge(B, own, j, k, p, angle, omega, n, length, over, s_hinge, dt, stage)
                            fx, fy = force(B, p, couple)
                            point(B, own, j, p, fx, fy, s_point, dt, t, stage)
                    for j in range(W):
                        p = (n - TWO) * NEXT + j
                        fx, fy = force(B, p, 0.0)
                        point(B, own, j, p, fx, fy, (float(n) - 2.0) * length, dt, t, stage)
                        p += NEXT
                        B[TX + p] = B[TX + p - NEXT]
                        B[TY + p] = B[TY + p - NEXT]
                        point(B, own, j, p, 0.0, 0.0, (float(n) - 1.0) * length, dt, t, stage)
                    <<solve>>
            for j in range(W):
                grasp(B, hand, j, 1.0, tick)
            if not record(B, n, candidate, c + 1, out, alive[b]):
                break
"""
