"""The page: figures and tables in one file that needs nothing else."""

from __future__ import annotations

import base64
import io
import json
from pathlib import Path

import jinja2
import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from stages.report import figures
from stages.report.player import animation
from stages.report.record import Cast, Record

HERE = Path(__file__).parent


def report(record: Record) -> str:
    """The page as text."""
    loader = jinja2.FileSystemLoader(HERE)
    page = jinja2.Environment(loader=loader, autoescape=True, undefined=jinja2.StrictUndefined)
    return page.get_template("page.html.j2").render(
        record=record,
        casts=[_cast(record, number, cast) for number, cast in enumerate(record.casts, start=1)],
        trajectory=_picture(figures.trajectory(record), "Way of the hand in each cast") if record.casts else "",
        parameters=_picture(figures.parameters(record), "Parameters over the casts") if record.estimates else "",
        table=_parameter_rows(record),
        config=json.dumps(record.config, indent=2),
        made_by=json.dumps(record.made_by, indent=2),
        player=Markup((HERE / "player.js").read_text(encoding="utf-8")),
        style=Markup((HERE / "page.css").read_text(encoding="utf-8")),
    )


def _cast(record: Record, number: int, cast: Cast) -> dict[str, object]:
    """What the page shows of one manipulation."""
    readings, link = cast.points.readings, cast.trial.link.iloc[0]
    unread = readings[~readings["valid"].astype(bool)]
    fit = None if cast.estimate is None else cast.estimate.fit.iloc[0]
    pictures = {
        "overlay": (figures.overlay(record, cast), "Camera and simulation at the closest approach"),
        "strip": (figures.strip(record, cast), "Camera and simulation over the movement"),
        "matching": (figures.matching(cast), "Matching rate over time"),
        "residual": (figures.residual(record, cast), "Residual over arc length and time"),
        "joints": (figures.joints(cast), "Joint angles"),
    }
    return {
        "number": number,
        "verdict": cast.verdict,
        "miss": f"{cast.verdict.distance * 1e3:.0f} mm" if np.isfinite(cast.verdict.distance) else "unknown",
        "fit": fit,
        "link": link,
        "attempts": cast.motion.attempts.to_dict("records"),
        "outcome": cast.motion.outcome.iloc[0],
        "frames": len(readings),
        "unread": unread["reason"].value_counts().to_dict(),
        "animation": Markup(json.dumps(animation(record, cast))),
        **{name: _picture(figure, words) for name, (figure, words) in pictures.items()},
    }


def _parameter_rows(record: Record) -> list[dict[str, object]]:
    """The last estimate, for reading."""
    return record.estimates[-1].parameters.to_dict("records") if record.estimates else []


def _picture(figure: Figure, words: str) -> Markup:
    """An inline PNG with its alternative text, at twice the size for sharp screens."""
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=150)
    text = base64.b64encode(data.getvalue()).decode()
    return Markup('<img alt="{}" src="data:image/png;base64,{}">').format(words, text)
