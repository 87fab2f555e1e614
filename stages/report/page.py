"""A page is a list of sections, a section a list of parts; each kind of part is a class here and a macro of its name in
`page.html.j2`. What is said is decided in Python, how it looks in the template and in `theme.css`."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from stringcast.stages.report import words
from stringcast.stages.report.theme import THEME, Picture

HERE = Path(__file__).parent


class Part:
    """Anything that a page shows; markupsafe's protocol lets a template or another part simply name it."""

    def __html__(self) -> str:
        """The part as HTML, everything in it escaped that is not Markup."""
        return str(getattr(_templates().get_template("parts.html.j2").module, type(self).__name__.lower())(self))


@dataclass(frozen=True)
class Text(Part):
    """A paragraph. kind: lead, missing (what is not there) or key."""

    words: str
    kind: str = "lead"


@dataclass(frozen=True)
class Tile(Part):
    """A number to remember, and what it is."""

    value: str
    words: str


@dataclass(frozen=True)
class Tiles(Part):
    """Tiles side by side."""

    tiles: Sequence[Tile]


@dataclass(frozen=True)
class Cell:
    """A cell of a table. kind: n (a number), code or missing. title: shown where a pointer rests on it."""

    words: Any
    kind: str = ""
    title: str = ""


@dataclass(frozen=True)
class Table(Part):
    """columns: headings; none for a table of names and values. Cells are `Cell` or words. named: the first of a row
    is its heading."""

    columns: Sequence[str]
    rows: Sequence[Sequence[Any]]
    named: bool = False

    @property
    def cells(self) -> list[list[Cell]]:
        """Every cell as a `Cell`."""
        return [[cell if isinstance(cell, Cell) else Cell(cell) for cell in row] for row in self.rows]


@dataclass(frozen=True)
class Key(Part):
    """What colours mean: words, and a CSS colour or the class of a mark."""

    entries: Sequence[tuple[str, str]]


@dataclass(frozen=True)
class Figure(Part):
    """A picture with its caption; `otherwise` stands where there is nothing to draw."""

    title: str
    picture: Picture | None
    caption: str
    otherwise: str = ""
    beside: Part | None = None


@dataclass(frozen=True)
class Small(Part):
    """Small pictures side by side, each below its words. kind: small, or strip for words below."""

    pictures: Sequence[tuple[str, Picture]]
    kind: str = "small"


@dataclass(frozen=True)
class Card(Part):
    """Parts in a frame."""

    title: str
    parts: Sequence[Part]
    kind: str = ""


@dataclass(frozen=True)
class Grid(Part):
    """Cards side by side, as many as there is room for."""

    parts: Sequence[Part]


@dataclass(frozen=True)
class Details(Part):
    """What is folded away behind a line."""

    summary: str
    parts: Sequence[Part]


@dataclass(frozen=True)
class Player(Part):
    """Frames with the strings drawn over them. film: see `charts.camera.animation`. layers: colours of its strings."""

    film: Mapping[str, Any] = field(repr=False)
    layers: Mapping[str, str]


@dataclass(frozen=True)
class Section(Part):
    """A heading and its parts. badge: beside the heading. anchor: that links lead to."""

    title: str
    parts: Sequence[Part | None]
    anchor: str = ""
    badge: str = ""
    kind: str = ""


@dataclass(frozen=True)
class Page:
    """title: of the window. kicker: above the heading. tone: good or bad, the heading's colour and mark. nav: links to
    sections. origin: seed, code, packages. settings: by name. script: of the page's own."""

    title: str
    kicker: str
    heading: str
    lead: str
    sections: Sequence[Section | Tiles | Part | None]
    origin: Mapping[str, Any]
    settings: Mapping[str, Any]
    tone: str = ""
    marked: bool = False
    nav: Sequence[tuple[str, str]] = ()
    script: str = field(default="", repr=False)

    def __str__(self) -> str:
        """The page as text; the same record gives the same page. One file that needs nothing else."""
        allowed = f"; script-src 'sha256-{_digest(self.script)}'" if self.script else ""
        return _templates().get_template("page.html.j2").render(page=self, again=self.again, allowed=Markup(allowed))

    @property
    def again(self) -> Section:
        """How to make it again."""
        origin = f"Origin: seed {self.origin['seed']}, code {self.origin['code']['commit'][:10]}"
        settings = "All settings, by their names on the command line"
        folded = [Details(line, [named(of)]) for line, of in ((origin, self.origin), (settings, self.settings))]
        return Section("How to make this again", folded)


def number(text: Any) -> Cell:
    """A cell with a number."""
    return Cell(text, "n")


def named(settings: Mapping[str, Any]) -> Table:
    """Settings by their names on the command line."""
    return Table((), [(name, Cell(value, "code")) for name, value in words.settings(settings)], named=True)


def badge(hit: bool) -> Markup:
    """Hit or missed, in words and colour."""
    kind, text = ("good", "✓ hit") if hit else ("bad", "✗ missed")
    return Markup('<span class="badge {}">{}</span>').format(kind, text)


def link(where: str, text: Any) -> Markup:
    """A link within the page or to one beside it."""
    return Markup('<a href="{}">{}</a>').format(where, text)


def code(text: str) -> Markup:
    """Words that are typed."""
    return Markup("<code>{}</code>").format(text)


def bold(text: str) -> Markup:
    """Words to see first."""
    return Markup("<b>{}</b>").format(text)


def joined(parts: Iterable[Any]) -> Markup:
    """Sentences one after another, each escaped unless it is Markup; those that are empty are left out."""
    return Markup(" ").join(part for part in parts if part)


@cache
def player_script() -> str:
    """What makes every `Player` of a page play."""
    return (HERE / "player.js").read_text(encoding="utf-8")


def _digest(script: str) -> str:
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()


@cache
def _templates() -> jinja2.Environment:
    """Data are escaped; a name that is not there is an error."""
    templates = jinja2.Environment(
        loader=jinja2.FileSystemLoader(HERE),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    sheet = (HERE / "theme.css").read_text(encoding="utf-8")
    templates.globals |= {"theme": THEME, "sheet": Markup(sheet), "Markup": Markup}
    return templates
