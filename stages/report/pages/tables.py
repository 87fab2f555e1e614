"""The page of a stage that has none of its own: what it says, and the first rows of its
tables.
"""

from __future__ import annotations

from stringcast.stages.report.page import Card, Page, Section, Table, Text
from stringcast.stages.report.records import StageRecord

ROWS = 50  # of a table that are shown


def tables_page(facts: StageRecord) -> str:
    """The page as text; the same facts give the same page."""
    sections = []
    for name, table in facts.artifact.TABLES.items():
        frame = getattr(facts.artifact, name)
        columns = [column for column in table.columns if column.kind != "bytes"]
        cut = f"; the first {ROWS} of {len(frame)} rows" if len(frame) > ROWS else ""
        heads = [
            f"{column.name} / {column.unit}" if column.unit else column.name
            for column in columns
        ]
        rows = (
            frame[[column.name for column in columns]]
            .head(ROWS)
            .to_numpy(object)
            .tolist()
        )
        sections.append(
            Section(
                table.name,
                [Text(f"{table.meaning}{cut}"), Card("", [Table(heads, rows)])],
            )
        )
    kicker = f"stringcast · {facts.name}"
    return str(
        Page(
            facts.name,
            kicker,
            facts.name,
            facts.sentence,
            sections,
            facts.provenance,
            facts.settings,
        )
    )
