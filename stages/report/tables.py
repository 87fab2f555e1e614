"""The page of a stage that has none of its own: what it says, and the first rows of its tables."""

from __future__ import annotations

from stringcast.stages.report.facts import Facts
from stringcast.stages.report.template import template

ROWS = 50  # of a table that are shown


def tables_report(facts: Facts) -> str:
    """The page as text; the same facts give the same page."""
    tables = [(table, getattr(facts.made, name)) for name, table in facts.made.TABLES.items()]
    return template("tables.html.j2").render(record=facts, tables=tables, rows=ROWS)
