"""The page of a diagnosis."""

from __future__ import annotations

from collections.abc import Callable

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
from stringcast.stages.report.parts import Part
from stringcast.stages.report.records import DiagnosisRecord, StageRecord
from stringcast.stages.report.theme import STYLE_SHEET
from stringcast.stages.workers import map_in_workers

VERDICT_TONES = {
    "none": "good",
    "partial": "bad",
    "unknown": "bad",
    "insufficient": "bad",
}
SECTIONS: tuple[Callable[[DiagnosisRecord], Part | None], ...] = (
    opening_part,
    rejected_card,
    causes_section,
    budget_section,
    misfit_section,
    trials_section,
    search_section,
    held_out_section,
    unexplained_section,
    parameters_section,
)


def diagnosis_page(facts: StageRecord) -> str:
    """Render the page of a diagnosis."""
    record = DiagnosisRecord(facts.artifact, facts.model)
    with style.context(STYLE_SHEET):
        sections = map_in_workers(lambda section: section(record), SECTIONS)
    heading = verdict_headline(record.document)
    tone = VERDICT_TONES.get(record.document["verdict"], "")
    return stage_page(facts, "diagnosis", sections, heading, tone=tone)
