"""The setting `method`, and the printed summary of a run."""

import io
import re

import pytest

from stringcast.pipeline.cli.console import print_summary
from stringcast.pipeline.cli.terminal import Terminal, with_program_name
from stringcast.pipeline.run.result import RunResult
from stringcast.pipeline.settings.composition import compose_settings

PAPERS = ("stringA", "stringB", "stringC", "stringD", "obstacle")


def parts(settings):
    return [
        settings[stage]["_target_"].split(".")[-2] for stage in ("generate", "estimate")
    ] + [settings["trials_used"]]


@pytest.mark.parametrize("name", PAPERS)
def test_experiments_of_the_paper_accept_both_methods(name):
    plain, robust = (
        compose_settings([f"+experiment={name}", *method])
        for method in ([], ["method=robust"])
    )
    assert compose_settings([f"+experiment={name}", "method=paper"]) == plain
    assert parts(plain) == ["generate", "random_search", 1]
    assert (plain["string"]["integrator"]["_target_"], plain["string"]["points"]) == (
        "stages.model.engine.integrators.SemiImplicitEuler",
        25 if name == "stringD" else 10,
    )
    assert parts(robust) == ["robust", "least_squares", 5]
    assert (
        robust["string"]["integrator"]["_target_"]
        == "stages.model.engine.implicit_leapfrog.ImplicitLeapfrog"
    )
    assert {key: robust[key] for key in ("specimen", "target", "obstacles")} == {
        key: plain[key] for key in ("specimen", "target", "obstacles")
    }


@pytest.mark.parametrize(
    "words", [[], ["target.x=0.45", "seed=3"], ["effects=[tip_mass]"], ["specimen=D"]]
)
def test_default_method_is_robust(words):
    plain = compose_settings(words)
    assert parts(plain) == ["robust", "least_squares", 5]
    assert plain == compose_settings([*words, "method=robust"])


def test_paths_are_not_wrapped(tmp_path):
    """A wrapped path cannot be pasted."""
    folder = tmp_path / ("a-long-name-of-a-folder-" * 4)
    out = Terminal(file=io.StringIO(), width=80)
    print_summary(RunResult(folder, (), "The tip reached the target."), out)
    *_, page = out.file.getvalue().splitlines()
    assert page == str(folder)


@pytest.mark.parametrize(
    "outcome",
    [
        "The tip reached the target.",
        "Dry run: " + "a sentence that is longer than a line " * 3,
    ],
)
def test_outcome_of_a_run_is_printed_in_full(tmp_path, outcome):
    out = Terminal(file=io.StringIO(), width=80)
    print_summary(
        RunResult(tmp_path, (), f"{outcome.strip()}. Nothing is learned from it."), out
    )
    shown = " ".join(re.sub("[│╭╮╰╯─]", " ", out.file.getvalue()).split())
    assert f"{outcome.strip()}" in shown
    assert "Nothing is learned from it." in shown
    assert "cast" not in shown.partition(str(tmp_path))[0], "a heading without rows"


def test_pip_commands_name_the_running_interpreter():
    """`pip` alone may belong to another interpreter."""
    outcome = with_program_name("h5py is needed: pip install h5py")
    assert re.fullmatch(r"h5py is needed: \S*python\S* -m pip install h5py", outcome)
    assert with_program_name(outcome) == outcome
