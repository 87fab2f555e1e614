"""All calls of the pipeline on pages are valid: settings compose, commands exist."""

import re
import shlex
import subprocess
from pathlib import Path

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser

from stringcast.pipeline.commands import COMMAND_NAMES, load_command
from stringcast.pipeline.settings.composition import compose_settings

ROOT = Path(__file__).resolve().parents[2]
CALL = re.compile(r"python3? (?:-m pipeline|tasks\.py run)(?![.\w])(.*)")
# placeholders, such as <folder> and outputs/...
PLACEHOLDER = re.compile(r"<[^>]*>|[\w/.-]*\.\.\.[\w/.-]*")


def pages():
    listed = subprocess.run(
        ["git", "ls-files", "*.md"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    return listed.stdout.split()


def find_in_code(pattern):
    """Find a pattern in code lines and backquotes of all pages."""
    for page in pages():
        for line in (ROOT / page).read_text(encoding="utf-8").splitlines():
            is_code = line.startswith("    ")
            for piece in [line] if is_code else re.findall(r"`([^`]+)`", line):
                if found := pattern.search(piece):
                    yield page, found


def calls():
    """Return page and arguments of all calls, without comments."""
    for page, found in find_in_code(CALL):
        yield page, found[1].partition(" #")[0].strip()


def first_of(override):
    """Return an override, or the first value of a sweep."""
    parsed = OverridesParser.create().parse_override(override)
    if not parsed.is_sweep_override():
        return override
    return (
        f"{parsed.input_line.partition('=')[0]}={next(parsed.sweep_string_iterator())}"
    )


def fill_plugin(folder, call):
    """Write the plugin of the pages, if a call names it."""
    if "my_lab" in call:
        for words in (["stage", "sway"], ["estimator", "uniform_search"]):
            assert load_command("new")([*words, "--to", str(folder)]) == 0


CALLS = sorted(set(calls()))


def test_calls_are_found_on_pages():
    assert len(CALLS) > 40


@pytest.mark.parametrize(
    ("page", "call"), CALLS, ids=[f"{page}: {call}"[:90] for page, call in CALLS]
)
def test_calls_on_pages_are_valid(page, call, plugin):
    if call.partition(" ")[0] in COMMAND_NAMES:
        return
    fill_plugin(plugin, call)
    words = [
        word
        for word in shlex.split(PLACEHOLDER.sub("place", call))
        if word not in ("--multirun", "--help")
    ]
    assert compose_settings(
        [first_of(word) for word in words if not word.endswith("=")]
    )["mode"]


def code_lines(page):
    """Return the code lines of a page, with Python as `python`."""
    lines = (ROOT / page).read_text(encoding="utf-8").splitlines()
    lines = [line.replace(".venv/bin/python", "python") for line in lines]
    return [line.strip() for line in lines if line.startswith("    ")]


def perform_line(line, folder, called):
    """Run a line of a page in a folder; return status and output.

    Python runs in this process, other commands in a shell.
    """
    words = shlex.split(line)
    if words[:2] == ["python", "-c"]:
        exec(words[2], {})
        return 0, ""
    if words[:3] == ["python", "-m", "pipeline"]:
        paths = {path.name: str(path) for path in folder.iterdir()}
        result = called(*[paths.get(word, word) for word in words[3:]])
    else:
        result = subprocess.run(
            ["bash", "-c", line], cwd=folder, capture_output=True, text=True, check=True
        )
    return result.returncode, result.stdout


def test_first_ten_minutes_run_as_on_the_page(called, tmp_path, monkeypatch):
    """All of data/README.md up to the diagnosis is run in an empty folder."""
    (tmp_path / "data").symlink_to(ROOT / "data")
    monkeypatch.chdir(tmp_path)
    lines = code_lines("data/README.md")
    first, last = (
        lines.index(next(line for line in lines if line.endswith(end)))
        for end in ("-p mine", "check wrong")
    )
    printed, status = "", 0
    for line in lines[first : last + 1]:
        assert status == 0, printed
        status, words = perform_line(line, tmp_path, called)
        printed += words
        monkeypatch.chdir(tmp_path)
    assert "trial,t,q1,q2,q3" in printed
    usable, _, wrong = printed.partition("Usable: 5 trials")
    assert "Not usable" not in usable
    assert "Multiply x and y by 0.001" in wrong
    assert (status, "Not usable" in wrong) == (1, True)


def test_short_commands_of_the_front_page_work(called, tmp_path):
    checked = called("check", "data/sample")
    assert checked.returncode == 0
    assert "Usable: 5 trials; nothing looks wrong" in checked.stdout
    assert called("board", tmp_path / "board.pdf").returncode == 0
    assert (tmp_path / "board.pdf").read_bytes().startswith(b"%PDF")
    assert called("index", tmp_path).returncode == 0
    assert "estimate.beta" in called("--help").stdout
