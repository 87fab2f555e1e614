"""The page of a diagnosis; each section or two has a file."""

from __future__ import annotations

from matplotlib import style

from stringcast.stages.report.formatting import verdict_headline
from stringcast.stages.report.page import stage_page
from stringcast.stages.report.pages.diagnosis.held_out import held_out_section
from stringcast.stages.report.pages.diagnosis.residuals import (
    misfit_section,
    opening_part,
    trials_section,
)
from stringcast.stages.report.pages.diagnosis.search import search_section
from stringcast.stages.report.pages.diagnosis.unexplained import (
    parameters_section,
    unexplained_section,
)
from stringcast.stages.report.pages.diagnosis.verdict import (
    budget_section,
    causes_section,
    rejected_card,
)
from stringcast.stages.report.records import DiagnosisRecord, StageRecord
from stringcast.stages.report.theme import STYLE_SHEET

VERDICT_TONES = {
    "none": "good",
    "partial": "bad",
    "unknown": "bad",
    "insufficient": "bad",
}


def diagnosis_page(facts: StageRecord) -> str:
    """Render the page; the same facts give the same text."""
    record = DiagnosisRecord(facts.artifact, facts.model)
    with style.context(STYLE_SHEET):
        sections = [
            opening_part(record),
            rejected_card(record),
            causes_section(record),
            budget_section(record),
            misfit_section(record),
            trials_section(record),
            search_section(record),
            held_out_section(record),
            unexplained_section(record),
            parameters_section(record),
        ]
    heading = verdict_headline(record.document)
    tone = VERDICT_TONES.get(record.document["verdict"], "")
    return stage_page(facts, "diagnosis", sections, heading, tone=tone)
