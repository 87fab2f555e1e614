"""The tasks of tasks.py, and the exit status of `test`."""

import pytest

import tasks


@pytest.mark.parametrize("code", [-9, -15, 1, 2, 3, 5, 127])
@pytest.mark.parametrize("command", ["ruff", "mypy", "pytest"])
@pytest.mark.parametrize("arguments", [[], ["--all"], ["tests/laws"]])
def test_nonzero_status_of_any_command_fails_the_task(
    monkeypatch, code, command, arguments
):
    """A negative status means a signal; pytest ends with 5 if it ran no test."""
    monkeypatch.setattr(
        tasks, "run_module", lambda name, *_, **__: code if name == command else 0
    )
    assert tasks.run_tests(arguments) == 1
    monkeypatch.setattr(tasks, "run_module", lambda *_, **__: 0)
    assert tasks.run_tests(arguments) == 0


def test_option_all_selects_long_tests(monkeypatch):
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


def test_package_links_are_updated_and_bytecode_is_kept(monkeypatch, tmp_path):
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


def test_run_with_only_skipped_tests_fails():
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
def test_task_run_adds_the_default_experiment(monkeypatch, given, called):
    monkeypatch.setattr(tasks, "run_module", lambda *words: " ".join(words))
    assert tasks.run_pipeline(given.split()) == f"pipeline {called}"
