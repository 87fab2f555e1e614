"""Print the step loop that is compiled for the paper's forces and further effects.

Usage: `python -m stringcast.stages.model.engine.print_loop [EFFECT ...]`, for example
`... tip_mass maxwell_slip`.
"""

from __future__ import annotations

import sys

from stringcast.stages.model.engine.kernel_codegen import generate_source
from stringcast.stages.model.library import find_effects
from stringcast.stages.model.string import PAPER_EFFECTS, String


def main(effects: list[str]) -> None:
    """Print the source text of the loop for the paper's forces and these effects."""
    string = String(0.3, effects=(*PAPER_EFFECTS, *find_effects(effects)))
    looped, _ = string.with_compiled_effects(
        string.material(string.start_values()[None])
    )
    print(generate_source(looped.effects, looped.row_names, looped.integrator))


if __name__ == "__main__":
    main(sys.argv[1:])
