"""The default page of a stage: the first rows of its tables."""

from __future__ import annotations

from stringcast.stages.report.page import stage_page
from stringcast.stages.report.parts import Section, Text, table_card
from stringcast.stages.report.records import StageRecord

MAX_ROWS = 50


def tables_page(facts: StageRecord) -> str:
    """Render the default page of a stage."""
    sections = []
    for name, table in facts.artifact.TABLES.items():
        frame = getattr(facts.artifact, name)
        columns = [column for column in table.columns if column.kind != "bytes"]
        names = [column.name for column in columns]
        heads = [f"{c.name} / {c.unit}" if c.unit else c.name for c in columns]
        meaning = table.meaning
        if len(frame) > MAX_ROWS:
            meaning += f"; the first {MAX_ROWS} of {len(frame)} rows"
        rows = frame[names].head(MAX_ROWS).to_numpy(object).tolist()
        parts = [Text(meaning), table_card(heads, rows)]
        sections.append(Section(table.name, parts))
    lead = "The tables that the stage stored."
    return stage_page(facts, "stage", sections, lead=lead)
