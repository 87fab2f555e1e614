"""Take the pictures out of a report, each as a file, and its curves as tables."""

from __future__ import annotations

import base64
import csv
import io
import json
import re
from collections.abc import Iterator, Sequence
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

from stringcast.data import disk
from stringcast.pipeline.commands import Arguments
from stringcast.pipeline.settings import UserError
from stringcast.pipeline.terminal import Terminal

ENDINGS = {"svg+xml": "svg", "webp": "webp", "png": "png"}


class Page(HTMLParser):
    """Finds the pictures of a page of ours. found: the headings above each, its kind, and its bytes."""

    def __init__(self) -> None:
        """Nothing is found yet."""
        super().__init__()
        self.found: list[tuple[str, str, bytes]] = []
        self.headings: dict[str, str] = {}
        self.within = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """A heading begins, or here is a picture."""
        if tag in ("h2", "h3"):
            self.headings = {name: text for name, text in self.headings.items() if name < tag} | {tag: ""}
            self.within = tag
        data = re.fullmatch(r"data:image/([^;]+);base64,(.*)", dict(attrs).get("src") or "", re.DOTALL)
        if tag == "img" and data and data[1] in ENDINGS:
            self.found.append((" ".join(self.headings.values()), ENDINGS[data[1]], base64.b64decode(data[2])))
        self.within = "script" if ("type", "application/json") in attrs else self.within

    def handle_endtag(self, tag: str) -> None:
        """A heading ends."""
        self.within = "" if tag == self.within else self.within

    def handle_data(self, data: str) -> None:
        """Words of a heading, or the data of curves."""
        if self.within == "script":
            drawn = json.loads(data)
            if "lines" in drawn:
                self.found.append((" ".join(self.headings.values()), "csv", table(drawn)))
        elif self.within:
            self.headings[self.within] += data


def table(drawn: dict[str, Any]) -> bytes:
    """Curves as CSV: time in ms, and a column a curve. drawn: `Chart.data` of stages.report.page."""
    text = io.StringIO()
    rows = csv.writer(text)
    rows.writerow(["t [ms]", *(f"{line['label']}, {drawn['axis']}" for line in drawn["lines"])])
    rows.writerows(zip(drawn["t"], *(line["values"] for line in drawn["lines"]), strict=True))
    return text.getvalue().encode()


def main(arguments: Sequence[str]) -> int:
    """Write the pictures of a page into a folder, numbered and named after the headings above them. The exit status."""
    parser = Arguments("python -m pipeline pictures", description=__doc__)
    parser.add_argument("page", type=Path, help="a report.html")
    parser.add_argument("folder", type=Path, help="for the pictures")
    asked = parser.parse_args(arguments)
    if not asked.page.is_file():
        raise UserError(f"{asked.page}: there is no such page. Name a report.html.")
    disk.make_folder(asked.folder)
    for name, content in pictures(asked.page.read_text(encoding="utf-8")):
        (asked.folder / name).write_bytes(content)
        Terminal(stderr=True).print(
            f"{asked.folder / name}  {len(content) / 1000:.0f} kB", highlight=False, markup=False
        )
    return 0


def pictures(page: str) -> Iterator[tuple[str, bytes]]:
    """Name and content of each picture of a page, in its order."""
    parser = Page()
    parser.feed(page)
    for number, (headings, ending, content) in enumerate(parser.found, start=1):
        words = re.sub(r"[^a-z0-9]+", "-", headings.lower()).strip("-")
        yield f"{number:02d}-{words}.{ending}", content
