"""The page of a diagnosis: the verdict, its evidence and the gain; a section or two is
a file.
"""

from __future__ import annotations

from matplotlib import style

from stringcast.stages.model.library import effects_by_name
from stringcast.stages.report.formatting import headline
from stringcast.stages.report.page import Page
from stringcast.stages.report.pages.diagnosis.prediction import gained
from stringcast.stages.report.pages.diagnosis.remainder import left, string
from stringcast.stages.report.pages.diagnosis.residuals import trials, wrong
from stringcast.stages.report.pages.diagnosis.search import found
from stringcast.stages.report.pages.diagnosis.verdict import (
    budget,
    causes,
    rejected,
    tiles,
)
from stringcast.stages.report.records import DiagnosisRecord, StageRecord
from stringcast.stages.report.theme import STYLE_SHEET

TONES = {"none": "good", "unknown": "bad", "insufficient": "bad"}


def stage_page(facts: StageRecord) -> str:
    """The page of a diagnosis as a stage made it."""
    given = (
        facts.name,
        facts.artifact,
        facts.model,
        effects_by_name(),
        facts.settings,
        facts.provenance,
        facts.next_commands,
    )
    return diagnosis_page(DiagnosisRecord(*given))


def diagnosis_page(record: DiagnosisRecord) -> str:
    """The page as text; the same record gives the same page."""
    with style.context(STYLE_SHEET):
        sections = [
            tiles(record),
            rejected(record),
            causes(record),
            budget(record),
            wrong(record),
            trials(record),
        ]
        sections += [found(record), gained(record), left(record), string(record)]
    return str(
        Page(
            title=f"{record.name}: {headline(record.document)}",
            kicker=f"stringcast diagnosis · {record.name}",
            heading=headline(record.document),
            lead=record.diagnosis.sentence,
            sections=sections,
            origin=record.origin,
            settings=record.settings,
            tone=TONES.get(record.document["verdict"], ""),
            following=record.following,
            explored=bool(record.trials or record.following),
        )
    )
