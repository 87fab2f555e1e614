"""Parts of a page: Python decides their content, templates decide their appearance.

A page is a list of sections, and a section is a list of parts. Each kind of part is a
class here and a macro of the same name in `parts.html.j2`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from markupsafe import Markup

from stringcast.stages.report import formatting
from stringcast.stages.report.theme import MS_PER_S, Picture

ASSET_FOLDER = Path(__file__).parent
FOLDER_PLACEHOLDER = "{here}"  # stands in commands for the page's folder


class Part:
    """Base class of parts; templates and other parts insert a part as HTML."""

    def __html__(self) -> str:
        """Render the part as HTML; everything except Markup is escaped."""
        macros = html_templates().get_template("parts.html.j2").module
        macro = getattr(macros, type(self).__name__.lower())
        return str(macro(self))


@dataclass(frozen=True)
class Text(Part):
    """A paragraph; its kind is lead, caption or missing (for missing content)."""

    words: str
    kind: str = "lead"


@dataclass(frozen=True)
class Tiles(Part):
    """Key numbers side by side, each with its meaning."""

    tiles: Sequence[tuple[str, str]]


@dataclass(frozen=True)
class Cell:
    """A cell of a table; its kind is n (a number), code, name or missing.

    The title is the cell's tooltip.
    """

    words: Any
    kind: str = ""
    title: str = ""


@dataclass(frozen=True)
class TableView(Part):
    """A table of cells or plain words; without columns, a list of names and values.

    Attributes
    ----------
    named : bool
        Whether the first cell of a row is its heading.
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[Any]]
    named: bool = False

    @property
    def cells(self) -> list[list[Cell]]:
        """Every entry of the rows as a `Cell`."""
        return [[_as_cell(entry) for entry in row] for row in self.rows]


def _as_cell(entry: Any) -> Cell:
    return entry if isinstance(entry, Cell) else Cell(entry)


@dataclass(frozen=True)
class Key(Part):
    """A legend: words, each with a CSS colour or the class of a mark."""

    entries: Sequence[tuple[str, str]]


@dataclass(frozen=True)
class Figure(Part):
    """A picture with its caption; `otherwise` replaces a picture that is None."""

    title: str
    picture: Picture | None
    caption: str
    otherwise: str = ""
    beside: Part | None = None


@dataclass(frozen=True)
class Small(Part):
    """Small pictures side by side, each with words above it."""

    pictures: Sequence[tuple[str, Picture]]


@dataclass(frozen=True)
class Card(Part):
    """Parts in a frame."""

    title: str
    parts: Sequence[Part]


@dataclass(frozen=True)
class Container(Part):
    """Cards in a layout of the style sheet: grid, column or trials (side by side)."""

    kind: str
    parts: Sequence[Part]


@dataclass(frozen=True)
class Details(Part):
    """Parts that are folded below a summary line."""

    summary: str
    parts: Sequence[Part]


@dataclass(frozen=True)
class Layer:
    """A layer of strings in a film, which the reader can show or hide.

    name: of the strings in the film's data. colour: of the theme, or #... label: for
    the reader; the name by default.
    """

    name: str
    colour: str
    dots: bool = False
    label: str = ""


@dataclass(frozen=True)
class FilmPlayer(Part):
    """Strings over time, drawn on camera frames if there are any.

    The data can be written as JSON; see `charts.camera.cast_film_data`.
    """

    data: Mapping[str, Any] = field(repr=False)
    words: str


@dataclass(frozen=True)
class Line:
    """A curve of a chart: values at the chart's times, NaN for gaps; a theme colour."""

    label: str
    values: np.ndarray = field(repr=False)
    colour: str
    dashed: bool = False

    @property
    def data(self) -> dict[str, Any]:
        """The curve for the page's script, to four significant figures."""
        values = np.asarray(self.values, float)
        rounded = [float(f"{v:.4g}") if np.isfinite(v) else None for v in values]
        return vars(self) | {"values": rounded}


@dataclass(frozen=True)
class Chart(Part):
    """Curves over time, with hovering and zooming.

    t: ascending times [s]. axis: its label with its unit. moving: interval [s] in which
    the arm moves. mark: moment [s] to mark. low: lower end of the axis.
    """

    title: str
    t: np.ndarray = field(repr=False)
    lines: Sequence[Line]
    axis: str
    caption: str = ""
    moving: tuple[float, float] | None = None
    mark: float | None = None
    low: float | None = 0.0

    @property
    def words(self) -> str:
        """The largest value of each curve, for screen readers."""
        largest = []
        for line in self.lines:
            known = line.values[np.isfinite(line.values)]
            size = np.abs(known).max(initial=0.0)
            largest.append(f"{line.label} {size:.3g}")
        return f"{self.title} over time, {self.axis}: at most {', '.join(largest)}."

    @property
    def data(self) -> dict[str, Any]:
        """The chart for the page's script: times in ms, null for missing values."""
        mark = None
        if self.mark is not None and np.isfinite(self.mark):
            mark = self.mark * MS_PER_S
        return {
            "t": np.round(np.asarray(self.t, float) * MS_PER_S, 2).tolist(),
            "lines": [line.data for line in self.lines],
            "axis": self.axis,
            "moving": self.moving and [end * MS_PER_S for end in self.moving],
            "mark": mark,
            "low": self.low,
        }


@dataclass(frozen=True)
class Explore(Part):
    """Films and charts that share one clock.

    times: whether the reader can magnify the differences between the strings. plays:
    whether the clock runs in a loop until the reader stops it.
    """

    parts: Sequence[Part]
    layers: Sequence[Layer] = ()
    times: bool = False
    plays: bool = False


@dataclass(frozen=True)
class Jump(Part):
    """A button that sets the clock of its group to a time [ms]."""

    t: float
    words: str


@dataclass(frozen=True)
class Commands(Part):
    """Commands to continue with: purpose and command line.

    The browser replaces FOLDER_PLACEHOLDER by the page's own folder.
    """

    commands: Sequence[tuple[str, str]]

    @property
    def rows(self) -> list[tuple[str, list[str]]]:
        """Purposes, and the commands in pieces around the page's folder."""
        return [
            (why, command.split(FOLDER_PLACEHOLDER)) for why, command in self.commands
        ]


@dataclass(frozen=True)
class RunsView(Part):
    """A list of runs that can be sorted and filtered, with their casts as curves.

    table: a row for each run; the second column names it. casts: lists `miss_mm` and
    `E` over the casts, by the name of the run; None where a value is unknown.
    """

    table: TableView
    casts: Mapping[str, Mapping[str, Sequence[float | None]]]


@dataclass(frozen=True)
class Section(Part):
    """A heading with an optional badge, and parts; `anchor` is the target of links."""

    title: str
    parts: Sequence[Part | None]
    anchor: str = ""
    badge: str = ""
    kind: str = ""

    @property
    def place(self) -> str:
        """Name of the section in links: its anchor, or its title in lower case."""
        return self.anchor or re.sub(r"\W+", "-", str(self.title).lower()).strip("-")


def number_cell(text: Any) -> Cell:
    """Create a cell with a number."""
    return Cell(text, "n")


def number_cells(texts: Iterable[Any]) -> list[Cell]:
    """Create cells with numbers."""
    return [number_cell(text) for text in texts]


def name_value_table(rows: Sequence[Sequence[Any]]) -> TableView:
    """Create a table without a heading, with a name and its values in each row."""
    return TableView((), rows, named=True)


def table_card(columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> Card:
    """Create a frame around a table."""
    return Card("", [TableView(columns, rows)])


def settings_table(settings: Mapping[str, Any]) -> TableView:
    """List settings by their names on the command line."""
    rows = []
    for name, value in formatting.setting_texts(settings):
        rows.append((name, Cell(value, "code")))
    return name_value_table(rows)


def hit_badge(hit: bool) -> Markup:
    """Mark a cast as hit or missed, in words and colour."""
    kind, text = ("good", "✓ hit") if hit else ("bad", "✗ missed")
    return Markup('<span class="badge {}">{}</span>').format(kind, text)


def link(where: str, text: Any) -> Markup:
    """Link to an anchor of the page, or to another page."""
    return Markup('<a href="{}">{}</a>').format(where, text)


def code_text(text: str) -> Markup:
    """Format code, such as a command."""
    return Markup("<code>{}</code>").format(text)


def bold_text(text: str) -> Markup:
    """Format text in bold."""
    return Markup("<b>{}</b>").format(text)


def join_sentences(sentences: Iterable[Any]) -> Markup:
    """Join sentences, each escaped unless it is Markup; skip empty ones."""
    return Markup(" ").join(sentence for sentence in sentences if sentence)


@cache
def html_templates() -> jinja2.Environment:
    """Load the templates; data are escaped, and an unknown name is an error."""
    templates = jinja2.Environment(
        loader=jinja2.FileSystemLoader(ASSET_FOLDER),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    templates.policies["json.dumps_kwargs"] = {"separators": (",", ":")}
    return templates
