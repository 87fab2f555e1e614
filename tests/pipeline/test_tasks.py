"""`python3 tasks.py test` ends with 0 only if everything was run and is clean."""

import pytest

import tasks


@pytest.mark.parametrize("code", [-9, -15, 1, 2, 3, 5, 127])
@pytest.mark.parametrize("command", ["ruff", "mypy", "pytest"])
@pytest.mark.parametrize("arguments", [[], ["--all"], ["tests/laws"]])
def test_any_command_that_does_not_end_with_0_fails(
    monkeypatch, code, command, arguments
):
    """Any command that does not end with 0 fails.

    A negative code is a signal's; pytest ends with 5 where it ran no test.
    """
    monkeypatch.setattr(
        tasks, "run_module", lambda name, *_, **__: code if name == command else 0
    )
    assert tasks.run_tests(arguments) == 1
    monkeypatch.setattr(tasks, "run_module", lambda *_, **__: 0)
    assert tasks.run_tests(arguments) == 0


def test_all_selects_the_long_ones_too(monkeypatch):
    called = []
    monkeypatch.setattr(
        tasks, "run_module", lambda *command, **_: called.append(command) or 0
    )
    tasks.run_tests([])
    short = [command for command in called if command[0] == "pytest"]
    called.clear()
    tasks.run_tests(["--all"])
    whole = [command for command in called if command[0] == "pytest"]
    assert [(*command, "-m", "") for command in short] == whole


def test_links_are_made_again_beside_the_bytecode_of_python(monkeypatch, tmp_path):
    monkeypatch.setattr(tasks, "LINKS", tmp_path / "package")
    monkeypatch.setattr(tasks, "ENVIRONMENT", tmp_path)
    tasks.link_package()
    package = tmp_path / "package" / "stringcast"
    (package / "__pycache__").mkdir()
    (package / "gone.py").symlink_to(tmp_path / "gone.py")
    tasks.link_package()
    assert (package / "__pycache__").is_dir()
    assert not (package / "gone.py").is_symlink()
    assert (package / "stages").resolve() == tasks.ROOT / "stages"


def test_a_run_of_which_every_test_was_skipped_fails():
    import conftest

    assert conftest.executed({"passed": [1]})
    assert conftest.executed({"failed": [1]})
    assert not conftest.executed({"skipped": [1], "deselected": [1]})


@pytest.mark.parametrize(
    ("given", "called"),
    [
        ("", "+experiment=stringB method=adaptive"),
        ("seed=3", "+experiment=stringB method=adaptive seed=3"),
        ("method=paper", "+experiment=stringB method=paper"),
        ("+experiment=stringC", "+experiment=stringC"),
        ("seed=1 +experiment=quick", "seed=1 +experiment=quick"),
        ("check data/sample", "check data/sample"),
    ],
)
def test_run_is_the_main_job_with_other_settings_unless_another_is_named(
    monkeypatch, given, called
):
    monkeypatch.setattr(tasks, "run_module", lambda *words: " ".join(words))
    assert tasks.run_pipeline(given.split()) == f"pipeline {called}"
