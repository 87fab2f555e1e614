"""A page is a list of sections, a section a list of parts; each kind of part is a class
here and a macro of its name in `page.html.j2`. What is said is decided in Python, how
it looks in the template and in `theme.css`.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from markupsafe import Markup

from stringcast.stages.report import formatting
from stringcast.stages.report.theme import MM_PER_M, THEME, Picture

HERE = Path(__file__).parent
SCRIPTS = ("vendor/uPlot.iife.min.js", "explore.js")


class Part:
    """Anything that a page shows; markupsafe's protocol lets a template or another part
    simply name it.
    """

    def __html__(self) -> str:
        """The part as HTML, everything in it escaped that is not Markup."""
        return str(
            getattr(
                _templates().get_template("parts.html.j2").module,
                type(self).__name__.lower(),
            )(self)
        )


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
    """A cell of a table. kind: n (a number), code or missing. title: shown where a
    pointer rests on it.
    """

    words: Any
    kind: str = ""
    title: str = ""


@dataclass(frozen=True)
class Table(Part):
    """columns: headings; none for a table of names and values. Cells are `Cell` or
    words. named: the first of a row is its heading.
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[Any]]
    named: bool = False

    @property
    def cells(self) -> list[list[Cell]]:
        """Every cell as a `Cell`."""
        return [
            [cell if isinstance(cell, Cell) else Cell(cell) for cell in row]
            for row in self.rows
        ]


@dataclass(frozen=True)
class Key(Part):
    """The key of colours: words, and a CSS colour or the class of a mark."""

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
    """Small pictures side by side, each below its words."""

    pictures: Sequence[tuple[str, Picture]]


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
class Column(Part):
    """Cards one below the other, beside a taller one."""

    parts: Sequence[Part]


@dataclass(frozen=True)
class Details(Part):
    """A block that is folded away behind a line."""

    summary: str
    parts: Sequence[Part]


@dataclass(frozen=True)
class Layer:
    """Strings of a film that can be shown or not. name: in its data. colour: of the
    theme, or #... shown: at first.
    """

    name: str
    colour: str
    dots: bool = False
    shown: bool = True


@dataclass(frozen=True)
class Film(Part):
    """Strings over time, over camera frames where there are any. data: see
    `charts.camera.animation`, JSON-able.
    """

    data: Mapping[str, Any] = field(repr=False)
    words: str


@dataclass(frozen=True)
class Line:
    """A curve of a chart. values: at its times; NaN where there is none. colour: a name
    of the theme.
    """

    label: str
    values: np.ndarray = field(repr=False)
    colour: str
    dashed: bool = False


@dataclass(frozen=True)
class Chart(Part):
    """Curves over time that are hovered over and zoomed. t: [s], ascending. axis: what
    is drawn, with its unit. words: for those who cannot see it. moving: while the arm
    moves [s]. mark: a moment [s]. low: end of the axis, if given.
    """

    title: str
    t: np.ndarray = field(repr=False)
    lines: Sequence[Line]
    axis: str
    words: str
    caption: str = ""
    moving: tuple[float, float] | None = None
    mark: float | None = None
    low: float | None = 0.0

    @property
    def data(self) -> dict[str, Any]:
        """The data of the page's script: times in ms, null where there is no value."""
        return {
            "t": np.round(np.asarray(self.t, float) * MM_PER_M, 2).tolist(),
            "lines": [
                {
                    "label": one.label,
                    "colour": one.colour,
                    "dashed": one.dashed,
                    "values": _figures(one.values),
                }
                for one in self.lines
            ],
            "axis": self.axis,
            "moving": None
            if self.moving is None
            else [end * MM_PER_M for end in self.moving],
            "mark": None
            if self.mark is None or not np.isfinite(self.mark)
            else self.mark * MM_PER_M,
            "low": self.low,
        }


@dataclass(frozen=True)
class Explore(Part):
    """Films and charts with one clock. layers: of its films. times: differences between
    them can be enlarged.
    """

    parts: Sequence[Part]
    layers: Sequence[Layer] = ()
    times: bool = False


@dataclass(frozen=True)
class Side(Part):
    """Cards of trials, side by side."""

    parts: Sequence[Part]


@dataclass(frozen=True)
class Jump(Part):
    """A button that sets the clock of its group. t: [ms]."""

    t: float
    words: str


# in a command: the page's own folder, which the reader's browser knows
FOLDER_PLACEHOLDER = "{here}"


@dataclass(frozen=True)
class Commands(Part):
    """Commands to go on with: why, and what to paste, in which HERE_IN_WORDS may stand."""

    commands: Sequence[tuple[str, str]]

    @property
    def rows(self) -> list[tuple[str, list[str]]]:
        """Words, and the command in pieces between which the page's folder stands."""
        return [
            (words, command.split(FOLDER_PLACEHOLDER))
            for words, command in self.commands
        ]


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
    """title: of the window. kicker: above the heading. tone: good or bad, for its
    colour and mark. nav: links to sections. origin: seed if any, code, packages.
    settings: by name. following: commands for what is next. explored: with films and
    curves, which need scripts.
    """

    title: str
    kicker: str
    heading: str
    lead: str
    sections: Sequence[Part | None]
    origin: Mapping[str, Any]
    settings: Mapping[str, Any]
    tone: str = ""
    marked: bool = False
    nav: Sequence[tuple[str, str]] = ()
    following: Sequence[tuple[str, str]] = ()
    explored: bool = False

    def __str__(self) -> str:
        """The page as text; the same record gives the same page. One file that needs
        nothing else.
        """
        scripts = [_read(name) for name in SCRIPTS] if self.explored else []
        digests = [
            base64.b64encode(hashlib.sha256(one.encode()).digest()).decode()
            for one in scripts
        ]
        allowed = (
            "; script-src " + " ".join(f"'sha256-{one}'" for one in digests)
            if scripts
            else ""
        )
        sheet = _read("theme.css") + (_read("vendor/uPlot.min.css") if scripts else "")
        given = {
            "ahead": Section("What next", [Card("", [Commands(self.following)])])
            if self.following
            else None,
            "again": self.again,
            "allowed": Markup(allowed),
            "scripts": map(Markup, scripts),
            "sheet": Markup(sheet),
        }
        return _templates().get_template("page.html.j2").render(page=self, **given)

    @property
    def again(self) -> Section:
        """The command that makes the page again."""
        seed = f"seed {self.origin['seed']}, " if "seed" in self.origin else ""
        origin = f"Origin: {seed}code {self.origin['code']['commit'][:10]}"
        settings = "All settings, by their names on the command line"
        folded = [
            Details(line, [named(of)])
            for line, of in ((origin, self.origin), (settings, self.settings))
            if of
        ]
        return Section("How to make this again", folded)


def number(text: Any) -> Cell:
    """A cell with a number."""
    return Cell(text, "n")


def named(settings: Mapping[str, Any]) -> Table:
    """Settings by their names on the command line."""
    return Table(
        (),
        [
            (name, Cell(value, "code"))
            for name, value in formatting.flatten_settings(settings)
        ],
        named=True,
    )


def badge(hit: bool) -> Markup:
    """Hit or missed, in words and colour."""
    kind, text = ("good", "✓ hit") if hit else ("bad", "✗ missed")
    return Markup('<span class="badge {}">{}</span>').format(kind, text)


def link(where: str, text: Any) -> Markup:
    """A link within the page or to one beside it."""
    return Markup('<a href="{}">{}</a>').format(where, text)


def code(text: str) -> Markup:
    """Words that are typed as they stand, such as a command."""
    return Markup("<code>{}</code>").format(text)


def bold(text: str) -> Markup:
    """Words that are to be seen first."""
    return Markup("<b>{}</b>").format(text)


def joined(parts: Iterable[Any]) -> Markup:
    """Sentences one after another, each escaped unless it is Markup; those that are
    empty are left out.
    """
    return Markup(" ").join(part for part in parts if part)


def either(title: str, part: Part | None, otherwise: str) -> Part:
    """The part, or in its place why there is none."""
    return part or Card(title, [Text(otherwise, "missing")])


def _figures(values: np.ndarray) -> list[float | None]:
    """Four significant figures, which is more than a screen shows."""
    return [
        float(f"{value:.4g}") if np.isfinite(value) else None
        for value in np.asarray(values, float)
    ]


@cache
def _read(name: str) -> str:
    return (HERE / name).read_text(encoding="utf-8")


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
    templates.globals |= {"theme": THEME}
    templates.policies["json.dumps_kwargs"] = {"separators": (",", ":")}
    return templates
