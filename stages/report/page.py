"""The page: figures and tables in one file that needs nothing else."""

from __future__ import annotations

import base64
import hashlib
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib import style

from stringcast.stages.report import words
from stringcast.stages.report.figures.joints import joints
from stringcast.stages.report.figures.matching import matching
from stringcast.stages.report.figures.overlay import overlay
from stringcast.stages.report.figures.parameters import history
from stringcast.stages.report.figures.paths import path, paths
from stringcast.stages.report.figures.progress import progress
from stringcast.stages.report.figures.residual import residual
from stringcast.stages.report.figures.strip import strip
from stringcast.stages.report.picture import ON_FRAMES, STYLE
from stringcast.stages.report.player import animation
from stringcast.stages.report.record import Cast, Record
from stringcast.stages.report.scene import View, whole_view
from stringcast.stages.report.template import template

HERE = Path(__file__).parent


def report(record: Record) -> str:
    """The page as text; the same record gives the same page."""
    script = (HERE / "player.js").read_text(encoding="utf-8")
    with style.context(STYLE):
        return template("page.html.j2").render(
            record=record,
            casts=_casts(record),
            paths=paths(record),
            progress=progress(record),
            best=_best(record),
            parameters=_parameters(record),
            matchings=[] if record.casts else [matching(estimate) for estimate in record.estimates],
            on_frames=ON_FRAMES,
            script=Markup(script),
            script_hash=base64.b64encode(hashlib.sha256(script.encode()).digest()).decode(),
        )


def _casts(record: Record) -> list[dict[str, Any]]:
    part = whole_view(record) if record.casts else None
    return [_cast(record, number, cast, part) for number, cast in enumerate(record.casts, start=1) if part]


def _cast(record: Record, number: int, cast: Cast, part: View) -> dict[str, Any]:
    """What the page shows of one manipulation."""
    return {
        "number": number,
        "verdict": cast.verdict,
        "fit": None if cast.estimate is None else cast.estimate.fit.iloc[0],
        "link": cast.trial.link.iloc[0],
        "attempts": cast.motion.attempts.sort_values("count", ascending=False).to_dict("records"),
        "plan": cast.motion.outcome.iloc[0],
        "frames": len(cast.points.readings),
        "unread": words.unread(cast.points.readings),
        "finite": {"before": np.isfinite(cast.before).all(), "after": np.isfinite(cast.after).all()},
        "animation": animation(record, cast, part),
        "overlay": overlay(record, cast),
        "strip": strip(record, cast, part),
        "matching": matching(cast.estimate, cast),
        "residual": residual(record, cast),
        "joints": joints(cast),
        "path": path(record, cast),
    }


def _best(record: Record) -> Cast | None:
    """The cast that came closest; None where no tip was ever read."""
    known = [cast for cast in record.casts if np.isfinite(cast.verdict.distance)]
    return min(known, key=lambda cast: (not cast.verdict.hit, cast.verdict.distance), default=None)


def _parameters(record: Record) -> list[dict[str, Any]]:
    """Each parameter of the last estimate, with its history."""
    if not record.estimates:
        return []
    last = record.estimates[-1].parameters.set_index("name", drop=False)
    known = [parameter for parameter in record.model.parameters if parameter.name in last.index]
    return [{"row": last.loc[p.name], "meaning": p.meaning, "history": history(p, record.estimates)} for p in known]
