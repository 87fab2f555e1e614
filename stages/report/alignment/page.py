"""The page of an alignment: what was measured, how well, and what looks alike."""

from __future__ import annotations

from matplotlib import style

from stringcast.data.alignment import Alignment
from stringcast.stages.report.alignment.figures import likelihood, places, residuals
from stringcast.stages.report.facts import Facts
from stringcast.stages.report.picture import STYLE
from stringcast.stages.report.template import template


def alignment_report(record: Facts) -> str:
    """The page as text; the same facts give the same page."""
    made: Alignment = record.made
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
