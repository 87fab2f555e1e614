"""Foreign text never controls the terminal: control characters are escaped."""

import ast
import io
import logging
import warnings

import numpy as np
import pytest
from conftest import ROOT
from rich.table import Table
from rich.text import Text

from stringcast.pipeline.cli.console import progress_bars
from stringcast.pipeline.cli.terminal import Terminal, explain_hydra_error
from stringcast.pipeline.run.log import LINE_FORMATTER, log_to_folder, log_warnings
from stringcast.pipeline.sweep.launcher import job_line
from stringcast.pipeline.sweep.ledger import Job

# escape sequences that name the window, and clear the screen in seven and eight bits
EVIL = "a\x1b]0;mine\x07\x1b[2J\x9b2Jb"


def table(text):
    made = Table(EVIL)
    made.add_row(text)
    return made


SHOWN = {
    "text": lambda out: out.print(EVIL, markup=False),
    "wrapped": lambda out: out.print(EVIL, soft_wrap=True),
    "table": lambda out: out.print(table(Text(EVIL))),
    "sweep": lambda out: out.print(
        job_line(Job(0, (f"name={EVIL}",), {}, error=EVIL), ""), soft_wrap=True
    ),
    "log": lambda out: out.file.write(
        LINE_FORMATTER.format(logging.makeLogRecord({"msg": EVIL}))
    ),
}


@pytest.mark.parametrize("kind", SHOWN)
def test_control_characters_are_escaped(kind):
    out = Terminal(file=io.StringIO(), width=200, no_color=True)
    SHOWN[kind](out)
    said = out.file.getvalue()
    assert "mine" in said
    assert not {"\x1b", "\x07", "\x9b"} & set(said)
    assert r"\x1b]0;mine" in said


def test_library_warnings_go_only_to_the_log(tmp_path, capfd):
    warnings.simplefilter("always")
    logging.captureWarnings(False)  # a command of another test leaves it on
    log_warnings()
    try:
        with log_to_folder(tmp_path):
            np.divide(1.0, 0.0)
    finally:
        logging.captureWarnings(False)
    assert "divide by zero" in (tmp_path / "run.log").read_text()
    assert "divide by zero" not in "".join(capfd.readouterr())


def test_progress_bar_escapes_its_name():
    out = Terminal(
        file=io.StringIO(), width=200, force_terminal=True, legacy_windows=False
    )
    with progress_bars(out) as bar, bar(EVIL) as progress:
        progress(0.5)
    assert "\x1b[2K" in out.file.getvalue()  # the bar clears its own line repeatedly
    assert "\x1b[2J" not in out.file.getvalue()
    assert r"a\x1b]0;mine" in out.file.getvalue()


def test_all_output_goes_through_the_terminal():
    """There is no other console; printed text of commands is escaped, or JSON."""
    for file in (ROOT / "pipeline").rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            called = ast.unparse(node.func) if isinstance(node, ast.Call) else ""
            assert called != "Console", file
            if called == "print" and file.parent.name == "commands":
                assert ast.unparse(node.args[0]).startswith(
                    ("escape_control_characters(", "json.dumps(")
                ), file


@pytest.mark.parametrize(
    ("words", "suggestion"),
    [
        (["graph", "plugins=[~/x]"], """'plugins=["~/x"]'"""),
        (["graph", "plugins=[~/x, y]"], """'plugins=["~/x","y"]'"""),
        (["name=Jörg"], """'name="Jörg"'"""),
    ],
)
def test_special_characters_are_suggested_with_quotes(words, suggestion, monkeypatch):
    monkeypatch.setattr("sys.argv", ["pipeline", *words])
    error = ValueError(f"LexerNoViableAltException: {words[-1]}\n  ^")
    remedy = explain_hydra_error(error).partition("Try: ")[2]
    assert remedy.endswith(suggestion)
