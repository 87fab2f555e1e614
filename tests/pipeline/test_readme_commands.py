"""Every call of the pipeline that a page shows is one: its settings compose, or it is a command that there is."""

import re
import shlex
import subprocess
from pathlib import Path

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser

from stringcast.pipeline.commands import NAMES
from stringcast.pipeline.settings import composed

ROOT = Path(__file__).resolve().parents[2]
CALL = re.compile(r"python3? (?:-m pipeline|tasks\.py run)(?![.\w])(.*)")
PLACEHOLDER = re.compile(r"<[^>]*>|[\w/.-]*\.\.\.[\w/.-]*")  # what a reader puts there: <folder>, outputs/...


def pages():
    listed = subprocess.run(["git", "ls-files", "*.md"], cwd=ROOT, capture_output=True, text=True, check=True)
    return listed.stdout.split()


def calls():
    """Page and arguments of every call in a code line or between backquotes, less what is said behind a #."""
    for page in pages():
        for line in (ROOT / page).read_text(encoding="utf-8").splitlines():
            pieces = [line] if line.startswith("    ") else re.findall(r"`([^`]+)`", line)
            for found in filter(None, map(CALL.search, pieces)):
                yield page, found[1].partition(" #")[0].strip()


def first_of(override):
    """An override, or the first of those that a sweep of it would give."""
    parsed = OverridesParser.create().parse_override(override)
    if not parsed.is_sweep_override():
        return override
    return f"{parsed.input_line.partition('=')[0]}={next(parsed.sweep_string_iterator())}"


CALLS = sorted(set(calls()))


def test_pages_show_calls():
    assert len(CALLS) > 40


@pytest.mark.parametrize(("page", "given"), CALLS, ids=[f"{page}: {given}"[:90] for page, given in CALLS])
def test_what_a_page_calls_can_be_called(page, given):
    if given.partition(" ")[0] in NAMES:
        return
    words = [word for word in shlex.split(PLACEHOLDER.sub("place", given)) if word not in ("--multirun", "--help")]
    assert composed([first_of(word) for word in words if not word.endswith("=")])["steps"]
