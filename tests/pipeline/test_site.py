"""The site holds all pages, and the commands on its first screen work."""

import importlib.util
import re
import shlex
import shutil
import socket
from fnmatch import filter as filter_names
from fnmatch import fnmatch
from html import unescape as html_text
from urllib.parse import unquote, urlsplit

import pytest

from docs.build import PAGES, ROOT, main, tracked_pages
from stringcast.pipeline.__main__ import run_command

FRONT = (PAGES / "index.md").read_text(encoding="utf-8")
NEEDED = ("sphinx", "furo", "myst_parser")


def test_contents_of_the_site_list_all_pages():
    contents = re.findall(r"^([\w/*]+)$|<(\w+)>$", FRONT, re.M)
    listed = [plain or titled for plain, titled in contents]
    pages = [page.with_suffix("").as_posix() for page in tracked_pages()]
    for page in pages:
        assert any(fnmatch(page, name) for name in listed), page
    for name in listed:
        assert filter_names([*pages, "api"], name), name


needs_sphinx = pytest.mark.skipif(
    not all(map(importlib.util.find_spec, NEEDED)),
    reason="Sphinx, furo and MyST are installed by `python3 tasks.py docs`",
)


@pytest.mark.long
@needs_sphinx
def test_site_builds_without_warnings_and_needs_no_network():
    assert main([]) == 0
    html = ROOT / "docs" / "site" / "html"
    words = (html / "searchindex.js").read_text("utf-8")
    assert all(word in words for word in ("watchdog", "fisher", "extended_model"))
    pages = {page: page.read_text("utf-8") for page in html.rglob("*.html")}
    for page, text in pages.items():
        loaded = re.findall(
            r"<(?:script|link|img)[^>]+(?:src|href)=\"(http[^\"]+)", text
        )
        assert loaded == [], page
        assert text.count('role="heading"') == text.count('role="heading" aria-level')
    assert broken_links(pages) == []


def broken_links(pages):
    """Return internal links to missing files or anchors."""
    places = {page: set(re.findall(r' id="([^"]+)"', pages[page])) for page in pages}
    broken = []
    for page, text in pages.items():
        for link in re.findall(
            r'<(?:a|img|script)\b[^>]* (?:href|src)="([^"]+)"', text
        ):
            address = urlsplit(html_text(link))
            if address.scheme:
                continue
            path = page.parent / unquote(address.path)
            target = page if not address.path else path.resolve()
            place = unquote(address.fragment)
            if not target.exists() or place not in {"", *places.get(target, [place])}:
                broken.append(f"{page.name}: {link}")
    return broken


def test_broken_links_are_found(tmp_path):
    page, other = tmp_path / "page.html", tmp_path / "other.html"
    page.touch()
    other.touch()
    pages = {
        page: (
            '<a href="other.html#there"></a> <a href="https://example.org"></a>'
            ' <a href="#own"></a><p id="own"></p> <img alt="" src="none.png">'
            ' <a class="x" href="other.html#nowhere"></a>'
        ),
        other: '<h1 id="there">',
    }
    assert broken_links(pages) == [
        "page.html: none.png",
        "page.html: other.html#nowhere",
    ]


@pytest.mark.long
@needs_sphinx
def test_external_links_work():
    try:
        socket.getaddrinfo("keepachangelog.com", 443)
    except OSError:
        pytest.skip("NO NETWORK HERE: LINKS TO OTHER SITES WERE NOT CHECKED.")
    assert main(["linkcheck"]) == 0


def test_first_screen_shows_five_commands_to_a_diagnosis(tmp_path, monkeypatch, capsys):
    """`tests/diagnosis/test_from_the_command_line.py` runs the last one."""
    shown = re.findall(r"^    (.+)$", FRONT, re.M)
    assert len(shown) == 5
    assert shown[1] == "cast/bin/pip install stringcast"
    assert shown[4] == "cast/bin/stringcast +experiment=diagnose trials=mine"
    for file in (ROOT / "data" / "tutorial").glob("*.csv"):
        shutil.copy(file, tmp_path)
    monkeypatch.chdir(tmp_path)
    for command in shown[2:4]:
        program, name, *words = shlex.split(command.replace("304mm", "282mm"))
        assert program == "cast/bin/stringcast"
        assert run_command(name, words) == 0
        assert "Usable: 5 trials; nothing looks wrong." in capsys.readouterr().out
