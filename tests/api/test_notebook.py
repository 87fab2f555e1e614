"""The notebook runs from its first cell to its last, and its statements hold."""

import re
import runpy
from pathlib import Path

import pytest


def test_the_notebook_runs_and_shows_what_it_says(capsys):
    made = runpy.run_path(str(Path(__file__).with_name("notebook.py")))
    shown = capsys.readouterr().out
    found = made["found"]
    known = found.parameters.set_index("name")
    assert (len(known), "<table" in found._repr_html_()) == (8, True)
    assert found.string.parameters == pytest.approx(found.artifact.values())
    assert (
        known.loc["bending_stiffness", "low"]
        < 1.5
        < 1.2 * known.loc["bending_stiffness", "high"]
    )
    millimetres = float(re.search(r"([\d.]+) mm root mean square", shown)[1])
    # more than the noise, because the wind is not modelled
    assert 0.7 < millimetres < 4
    # distance [m] from a box of 20 by 40 mm that the tip crosses between two samples
    assert made["nearest"] < 0.04
