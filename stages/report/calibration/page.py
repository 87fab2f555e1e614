"""The page of a calibration: figures and tables in one file that needs nothing else."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib import style

from stringcast.stages.report.calibration.figures.arrows import magnified
from stringcast.stages.report.calibration.figures.coverage import coverage
from stringcast.stages.report.calibration.figures.errors import errors
from stringcast.stages.report.calibration.figures.view import view
from stringcast.stages.report.facts import Facts
from stringcast.stages.report.picture import STYLE, Picture
from stringcast.stages.report.template import template


def calibration_report(record: Facts) -> str:
    """The page as text; the same record gives the same page."""
    made, outcome = record.made, record.made.outcome.iloc[0]
    tilted = made.corners[~made.corners["plane"]]
    times = magnified(tilted, outcome["width"])
    with style.context(STYLE):
        return template("calibration/page.html.j2", figures).render(
            record=record,
            outcome=outcome,
            degrees=float(np.degrees(outcome["spread"])),
            measured=made.measured.to_dict("records"),
            used=int((made.views["reason"] == "").sum()) - 1,
            given=len(made.views) - 1,
            times=times,
            coverage=coverage(tilted, outcome["width"], outcome["height"], times),
            errors=errors(made.views[~made.views["plane"] & (made.views["reason"] == "")]),
            views=list(_views(record, times)),
        )


def figures(row: dict[str, Any]) -> str:
    """A value with as many decimals as its uncertainty allows."""
    decimals = max(int(np.ceil(1 - np.log10(row["sigma"]))), 0) if row["sigma"] > 0 else 6
    return f"{row['value']:.{decimals}f} ± {row['sigma']:.{decimals}f}"


def _views(record: Facts, times: float) -> Iterator[tuple[str, str, Picture]]:
    """Name, words and picture of each view, that in the plane first."""
    every = record.made.corners
    for row in record.made.views.sort_values("plane", ascending=False, kind="stable").itertuples():
        name = "in the plane of motion" if row.plane else f"view {row.view}"
        corners = every[(every["view"] == row.view) & (every["plane"] == row.plane)]
        words = row.reason or f"{row.rms:.2f} px, tilted by {np.degrees(row.tilt):.0f}°"
        yield name, words, view(row.picture, corners, times, name)
