"""The page of an alignment: what was measured, how well, and what looks alike."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from matplotlib import style

from stringcast.data.alignment import Alignment
from stringcast.stages.report.alignment.figures import likelihood, places, residuals
from stringcast.stages.report.picture import STYLE
from stringcast.stages.report.template import template


@dataclass(frozen=True)
class AlignmentRecord:
    """What the page is made from."""

    name: str
    sentence: str
    alignment: Alignment = field(repr=False)
    settings: Mapping[str, Any] = field(repr=False)
    origin: Mapping[str, Any] = field(repr=False)


def alignment_report(record: AlignmentRecord) -> str:
    """The page as text; the same record gives the same page."""
    made = record.alignment
    with style.context(STYLE):
        return template("alignment/page.html.j2", shown).render(
            record=record,
            how=made.aligned.iloc[0].to_dict(),
            measured=made.measured.to_dict("records"),
            frames=len(made.seen[["trial", "t"]].drop_duplicates()),
            places=places(made.seen),
            residuals=residuals(made.seen),
            likelihood=likelihood(made.likelihood),
        )


def shown(value: float, unit: str) -> str:
    """A parameter as people think of it: in ms and mm; else in thousandths of its unit."""
    return f"{1e3 * value:.3f} " + {"s": "ms", "m": "mm", "rad": "mrad", "1": "‰"}[unit]
