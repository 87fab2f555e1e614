"""The notebook runs, and its statements hold."""

import importlib.util
import json
import re
import runpy
from dataclasses import replace

import pytest

import stringcast as sc
from stringcast.answers import DiagnosisResult
from stringcast.known import experiment_for_call
from tests.api.make_notebook import NOTEBOOK, SCRIPT, notebook_text
from tests.report.test_diagnosis_page import make_diagnosis

NEEDED = ("nbclient", "nbformat", "ipykernel")


def test_notebook_is_up_to_date_with_the_script():
    assert NOTEBOOK.read_text("utf-8") == notebook_text()
    cells = json.loads(notebook_text())["cells"]
    code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    assert sum("sc." in source for source in code) >= 5
    assert not any(line.startswith("#") for line in code[1].splitlines())


def test_notebook_script_runs_and_its_statements_hold(capsys, monkeypatch):
    """The diagnosis itself is replaced; other tests cover it."""
    stored = DiagnosisResult(
        make_diagnosis("effect", ["tip_mass"]), experiment_for_call((), None)
    )
    monkeypatch.setattr("stringcast.answers.diagnose", lambda trials: stored)
    made = runpy.run_path(str(SCRIPT))
    shown = capsys.readouterr().out
    assert "5 trials of a string of 304 mm: 17 points a frame, 200 frames" in shown
    assert stored.sentence in shown
    found = made["found"]
    known = found.parameters.set_index("name")
    assert (len(known), "<table" in found._repr_html_()) == (8, True)
    assert found.string.parameters == pytest.approx(found.artifact.values())
    low, high = known.loc["bending_stiffness", ["low", "high"]]
    assert low < 1.5 < 1.2 * high
    millimetres = float(re.search(r"([\d.]+) mm root mean square", shown)[1])
    # more than the noise, because the wind is not modelled
    assert 0.7 < millimetres < 4
    # distance [m] from a box of 20 by 40 mm that the tip crosses between two samples
    assert made["nearest"] < 0.04
    assert len(made["mine"]) == len(made["trials"])


def test_results_have_pictures_and_text():
    trials = sc.sample()
    assert str(trials).count("200.0") == 5
    assert "200 frames a second" in trials._repr_html_()
    result = DiagnosisResult(
        make_diagnosis("effect", ["tip_mass"]), experiment_for_call((), None)
    )
    assert result._repr_html_().count("<tr") == 1 + len(result.causes)
    widest = max(map(len, str(result.causes.to_string()).splitlines()))
    assert widest <= 80
    assert "<svg" in result.plot()._repr_svg_()
    artifact = make_diagnosis("effect", ["tip_mass"])
    artifact.causes["at_least"] = True
    result = DiagnosisResult(artifact, result.experiment)
    assert (result.causes["high"] == float("inf")).all()


def test_empty_diagnosis_cannot_be_drawn():
    made = make_diagnosis("insufficient")
    artifact = replace(made, residuals=made.residuals[:0], held_out=made.held_out[:0])
    result = DiagnosisResult(artifact, experiment_for_call((), None))
    with pytest.raises(sc.StringcastError, match=r"print\(trials\)"):
        result.plot()


@pytest.mark.long
@pytest.mark.skipif(
    not all(map(importlib.util.find_spec, NEEDED)),
    reason="nbclient and ipykernel are installed by `python3 tasks.py docs`",
)
def test_notebook_runs_cell_by_cell():
    import nbclient
    import nbformat

    notebook = nbformat.reads(notebook_text(), as_version=4)
    nbclient.NotebookClient(notebook, timeout=900).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    text = "".join(output.get("text", "") for output in outputs)
    assert "effect: " in text
    assert re.search(r"wind\s+1\.0", text)
    drawn = [output for output in outputs if "image/svg+xml" in output.get("data", {})]
    assert len(drawn) == 2
