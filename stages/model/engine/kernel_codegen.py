"""Source text and rows of the step loop for one set of effects.

`generate_source` writes a module that contains the laws of the effects and one loop
around them; Numba compiles it (`batching.py`). Other effects are not in the text and
take no time. It is text because Numba finds machine code of a file again in the next
process, but not that of a closure over functions (../README.md).

Candidates run side by side in lanes. Every quantity of a mass point or a segment is a
row with one number for each lane. The innermost loop runs over the row without
branches, so LLVM fills the vector units. LLVM must see that rows do not overlap.
Therefore all rows lie in one buffer at distances known at compile time, and even
temporary quantities, such as a segment's tension, have a row for each segment. The rows
of a point are adjacent, which spreads them evenly over the sets of the first cache.
Indices are unsigned, so none can be negative.

A pass measures a segment ahead of the point that it moves: segment i + 1 needs the old
positions of points i + 1 and i + 2, and point i + 1 needs the forces of segments i and
i + 1. Segment angles are unwrapped: each pass adds the turn since the last pass, so a
hinge may wind past +-pi.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING

from stringcast.data.lazy_module import LazyModule
from stringcast.stages.model.effect import StringEffect
from stringcast.stages.model.engine.implicit_leapfrog import MAX_BEND_PER_STEP
from stringcast.stages.model.engine.integrators import Integrator
from stringcast.stages.model.engine.law_slots import MEMORY_SLOTS
from stringcast.stages.model.engine.law_source import LawSource
from stringcast.stages.model.engine.step_loop_template import STEP_LOOP

if TYPE_CHECKING:
    import jinja2
else:
    jinja2 = LazyModule("jinja2")

LANES = 16  # candidates side by side: 128 bytes of each quantity, two cache lines

# Rows of a point and of the segment that starts there. The integrator's rows follow.
POINT_ROWS = (
    "X",
    "Y",
    "VX",
    "VY",
    "ANGLE",
    "SEGMENT_X",
    "SEGMENT_Y",
    "INVERSE_MASS",
    "LENGTH_PER_MASS",
    "TANGENT_X",
    "TANGENT_Y",
    "INVERSE_LENGTH",
    "TENSION",
    "TURN_RATE",
    "MOMENT",
    "FORCE_X",
    "FORCE_Y",
    "HAND_ANGLE",
    "HAND_RATE",
    "GRASP_REST_ANGLE",
)


def generate_source(
    effects: Sequence[type[StringEffect]],
    row_names: Sequence[str],
    integrator: Integrator,
    lanes: int = LANES,
) -> str:
    """Write the module of a step loop.

    Parameters
    ----------
    effects : sequence of StringEffect classes
        The effects whose laws are in the loop.
    row_names : sequence of str
        Names of the rows of parameters, as `String.row_names`.
    integrator : Integrator
        The time step.
    lanes : int
        Candidates side by side.

    Returns
    -------
    str
        Text of a Python module with the function `run`.
    """
    return _template(STEP_LOOP).render(
        laws=LawSource(effects, row_names),
        integrator=integrator,
        solve=_template(integrator.solve_source).render(integrator=integrator),
        rows=row_numbers(integrator, effects),
        lanes=lanes,
        max_bend_per_step=MAX_BEND_PER_STEP,
    )


def row_numbers(
    integrator: Integrator, effects: Sequence[type[StringEffect]]
) -> dict[str, int]:
    """Return the numbers of a point's rows by name.

    The last rows belong to laws with memory: the hinge's last curvature, and the state
    of each effect.
    """
    counts = []
    for memory_slot, _, _ in MEMORY_SLOTS.values():
        counts.append(sum(memory_slot in effect.laws() for effect in effects))
    memory = [f"MEMORY{i}" for i in range(max(counts))]
    if memory:
        memory.insert(0, "LAST_CURVATURE")
    names = (*POINT_ROWS, *integrator.row_names, *memory)
    return {name: number for number, name in enumerate(names)}


@cache
def _template(text: str) -> jinja2.Template:
    environment = jinja2.Environment(
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=jinja2.StrictUndefined,
    )
    return environment.from_string(text)
