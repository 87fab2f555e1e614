"""The step loop that is compiled for the paper's string, as one can read it."""

import ast
from pathlib import Path

from stringcast.stages.model import kernel
from stringcast.stages.model.string import String

SHOWN = Path(__file__).with_name("loop_of_paper.py")


def test_the_loop_shown_is_the_loop_that_runs():
    """Write it anew after a change of the loop: SHOWN.write_text(kernel.source(...)), then `ruff format`."""
    string = String(0.3)
    written = kernel.source(string.effects, string.rows, string.integrator)
    assert ast.dump(ast.parse(SHOWN.read_text())) == ast.dump(ast.parse(written))
