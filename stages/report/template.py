"""How pages are written: their templates, with the words, theme and style sheet that they share."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import jinja2
from markupsafe import Markup

from stringcast.stages.report import words
from stringcast.stages.report.picture import THEME

HERE = Path(__file__).parent


@cache
def template(name: str, *own: Callable[..., str]) -> jinja2.Template:
    """A page's template, with filters of its own. Data are escaped; a name that is not there is an error."""
    page = jinja2.Environment(
        loader=jinja2.FileSystemLoader(HERE),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    named = (
        words.mm,
        words.ms,
        words.rate,
        words.significant,
        words.symbol,
        words.sentence,
        words.unit,
        words.settings,
    )
    page.filters |= {function.__name__: function for function in (*named, *own)}
    page.globals |= {"theme": THEME, "sheet": Markup((HERE / "page.css").read_text(encoding="utf-8"))}
    return page.get_template(name)
