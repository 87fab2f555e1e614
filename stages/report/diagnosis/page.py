"""The page of a diagnosis: the verdict, its evidence and the gain, in one file that needs nothing else."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib import style

from stringcast.stages.model.library import library
from stringcast.stages.report.diagnosis import words
from stringcast.stages.report.diagnosis.figures.cause import cause
from stringcast.stages.report.diagnosis.figures.gain import foretold, likelier
from stringcast.stages.report.diagnosis.figures.likeness import likeness
from stringcast.stages.report.diagnosis.figures.maps import maps
from stringcast.stages.report.diagnosis.figures.missing import missing
from stringcast.stages.report.diagnosis.figures.overlay import overlays
from stringcast.stages.report.diagnosis.figures.proposed import proposed
from stringcast.stages.report.diagnosis.figures.screening import screenings
from stringcast.stages.report.diagnosis.figures.size import size
from stringcast.stages.report.diagnosis.figures.tip import tips
from stringcast.stages.report.diagnosis.record import DiagnosisRecord
from stringcast.stages.report.facts import Facts
from stringcast.stages.report.picture import STYLE
from stringcast.stages.report.template import template
from stringcast.stages.report.words import mm

FILTERS = (words.plain, words.percent, words.gain, words.quantity, words.interval, words.headline, words.joined)
FEW = 12  # theories shown at once; the others are folded
WORSE = 1.2  # times the residual without causes: that much more with them is worth a sentence
RARE = 0.01  # probability up to which an alternative is not worth a line


def stage_report(facts: Facts) -> str:
    """The page of a diagnosis as a stage made it."""
    given = (facts.name, facts.made, facts.model, library(), facts.settings, facts.origin)
    return diagnosis_report(DiagnosisRecord(*given))


def diagnosis_report(record: DiagnosisRecord) -> str:
    """The page as text; the same record gives the same page."""
    with style.context(STYLE):
        return template("diagnosis/page.html.j2", *FILTERS).render(
            record=record,
            document=record.document,
            extension=record.extension,
            causes=_causes(record),
            alternatives=[a for a in record.document["alternatives"] if a["probability"] > RARE],
            maps={model: maps(record, model) for model in record.models},
            size=size(record),
            overlays=overlays(record),
            tips=tips(record),
            theories=_theories(record.diagnosis.theories),
            few=FEW,
            screenings=screenings(record),
            likeness=likeness(record),
            foretold=foretold(record),
            likelier=likelier(record),
            held_out=record.diagnosis.held_out.to_dict("records"),
            worse=_worse(record),
            missing=missing(record),
            proposed=proposed(record),
            pushes=record.diagnosis.missing["s"].notna().any(),
            strongest=_strongest(record.diagnosis.missing),
        )


def _causes(record: DiagnosisRecord) -> list[dict[str, Any]]:
    """Each cause with its parameters, its picture and where it comes from."""
    return [_cause(record, str(name), rows) for name, rows in record.diagnosis.causes.groupby("effect", sort=False)]


def _cause(record: DiagnosisRecord, name: str, rows: pd.DataFrame) -> dict[str, Any]:
    parameters = rows[rows["parameter"] != ""]
    effect = record.library.get(name)
    values = {p.parameter.rpartition(".")[2]: p.value for p in parameters.itertuples()}
    return {
        "name": name,
        "probability": rows["probability"].iloc[0],
        "sentence": rows["sentence"].iloc[0],
        "parameters": parameters.to_dict("records"),
        "picture": cause(effect, values) if effect else None,
        "reference": effect.reference if effect else "",
    }


def _worse(record: DiagnosisRecord) -> list[dict[str, Any]]:
    """Trials that are foretold worse with the causes than without; and whether these explain them if fitted to them."""
    if len(record.models) == 1:
        return []
    table = record.diagnosis.held_out
    worse = table[table["rms_extended"] > WORSE * table["rms_base"]]
    known = worse.get("rms_known", worse["rms_extended"])
    return worse.assign(explained=WORSE * known < worse["rms_base"]).to_dict("records")


def _strongest(table: pd.DataFrame) -> str:
    """The most that is missing anywhere, with its unit. table: MISSING."""
    size = float(np.hypot(table["x"].fillna(0), table["y"].fillna(0)).max())
    return f"{size:.2g} m/s²" if table["s"].notna().any() else mm(size, 1)


def _theories(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Those that leave least come first; the base model is among the few that are shown."""
    rows = table.sort_values("fit_gain", ascending=False, kind="stable").reset_index(drop=True)
    base = rows["causes"] == ""
    late = base & (np.arange(len(rows)) >= FEW)
    order = np.where(late, FEW - 1.5, np.arange(len(rows)))
    return rows.iloc[np.argsort(order, kind="stable")].to_dict("records")
