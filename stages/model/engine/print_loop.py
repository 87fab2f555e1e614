"""Print the step loop for the paper's forces and further effects.

Usage: `python -m stringcast.stages.model.engine.print_loop [EFFECT ...]`, for example
`... tip_mass maxwell_slip`.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from stringcast.stages.model.effect import StringEffect
from stringcast.stages.model.engine.kernel_codegen import generate_source
from stringcast.stages.model.library import find_effects
from stringcast.stages.model.string import PAPER_EFFECTS, String


def main(effects: Sequence[str]) -> None:
    """Print the source text of the loop for the paper's forces and these effects."""
    further = [e for e in find_effects(effects) if issubclass(e, StringEffect)]
    string = String(0.3, effects=(*PAPER_EFFECTS, *further))
    material = string.material(string.start_values()[None])
    compiled, _ = string.with_compiled_effects(material)
    source = generate_source(compiled.effects, compiled.row_names, compiled.integrator)
    print(source)


if __name__ == "__main__":
    main(sys.argv[1:])
