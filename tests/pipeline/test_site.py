"""The site holds every page, and the commands that it begins with work."""

import importlib.util
import re
import shutil
import subprocess
import sys
from fnmatch import filter as filter_names
from fnmatch import fnmatch

import pytest

from docs.build import PAGES, ROOT, main, tracked_pages

FRONT = (PAGES / "index.md").read_text(encoding="utf-8")
NEEDED = ("sphinx", "furo", "myst_parser")


def test_every_page_is_in_the_contents_of_the_site():
    contents = re.findall(r"^([\w/*]+)$|<(\w+)>$", FRONT, re.M)
    listed = [plain or titled for plain, titled in contents]
    pages = [page.with_suffix("").as_posix() for page in tracked_pages()]
    for page in pages:
        assert any(fnmatch(page, name) for name in listed), page
    for name in listed:
        assert filter_names([*pages, "api"], name), name


@pytest.mark.long
@pytest.mark.skipif(
    not all(map(importlib.util.find_spec, NEEDED)),
    reason="Sphinx, furo and MyST are installed by `python3 tasks.py docs`",
)
def test_the_site_is_built_without_a_warning_and_needs_no_network():
    assert main([]) == 0
    html = ROOT / "docs" / "site" / "html"
    assert (html / "searchindex.js").stat().st_size > 1e5
    for page in html.rglob("*.html"):
        loaded = re.findall(
            r"<(?:script|link|img)[^>]+(?:src|href)=\"(http[^\"]+)",
            page.read_text("utf-8"),
        )
        assert loaded == [], page


def test_five_commands_lead_from_an_installation_to_a_diagnosis(tmp_path):
    """The first screen shows five commands; import and check are run as printed.

    The last one is run by `tests/diagnosis/test_from_the_command_line.py`.
    """
    shown = re.findall(r"^    (.+)$", FRONT, re.M)
    assert len(shown) == 5
    assert shown[1] == "cast/bin/pip install stringcast"
    assert shown[4] == "cast/bin/stringcast +experiment=diagnose trials=mine"
    for file in (ROOT / "data" / "tutorial").glob("*.csv"):
        shutil.copy(file, tmp_path)
    for command in shown[2:4]:
        words = command.replace("304mm", "282mm").replace(
            "cast/bin/stringcast", f"{sys.executable} -m stringcast"
        )
        done = subprocess.run(
            words, shell=True, cwd=tmp_path, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        assert "Usable: 5 trials; nothing looks wrong." in done.stdout
