"""The paper's experiments are cast by the paper's method or by the robust one."""

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
def test_an_experiment_of_the_paper_takes_either_method(name):
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
def test_a_plain_cast_is_the_robust_one(words):
    plain = compose_settings(words)
    assert parts(plain) == ["robust", "least_squares", 5]
    assert plain == compose_settings([*words, "method=robust"])


def test_what_can_be_pasted_is_on_one_line_of_any_terminal(tmp_path):
    """A text to be pasted is on one line of any terminal.

    A path that the terminal's width breaks cannot be pasted.
    """
    folder = tmp_path / ("a-long-name-of-a-folder-" * 4)
    out = Terminal(file=io.StringIO(), width=80)
    print_summary(RunResult(folder, (), "The tip reached the target."), out)
    *_, page = out.file.getvalue().splitlines()
    assert page == str(folder)


@pytest.mark.parametrize(
    "said",
    [
        "The tip reached the target.",
        "Dry run: " + "a sentence that is longer than a line " * 3,
    ],
)
def test_what_a_run_says_is_not_cut(tmp_path, said):
    out = Terminal(file=io.StringIO(), width=80)
    print_summary(
        RunResult(tmp_path, (), f"{said.strip()}. Nothing is learned from it."), out
    )
    shown = " ".join(re.sub("[│╭╮╰╯─]", " ", out.file.getvalue()).split())
    assert f"{said.strip()}" in shown
    assert "Nothing is learned from it." in shown
    assert "cast" not in shown.partition(str(tmp_path))[0], "a heading without rows"


def test_packages_are_installed_for_the_interpreter_that_lacks_them():
    """Packages are installed for the interpreter that lacks them.

    `pip` alone may belong to another interpreter.
    """
    said = with_program_name("h5py is needed: pip install h5py")
    assert re.fullmatch(r"h5py is needed: \S*python\S* -m pip install h5py", said)
    assert with_program_name(said) == said
