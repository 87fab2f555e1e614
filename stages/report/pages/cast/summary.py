"""The summary of all casts of a run."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup

from stringcast.stages.report.charts.cast import hand_paths_picture
from stringcast.stages.report.formatting import (
    NOT_KNOWN,
    format_mm,
    format_ms,
    format_percent,
    format_rate,
)
from stringcast.stages.report.parts import (
    Cell,
    Figure,
    Part,
    Tiles,
    hit_badge,
    link,
    number_cell,
    number_cells,
    table_card,
)
from stringcast.stages.report.records import CastRecord, RunRecord

NO_JOINT_ANGLES = "The arm reported no joint angles."


def summary_parts(record: RunRecord, casts: list[tuple[int, CastRecord]]) -> list[Part]:
    """Summarise the run in tiles, and in a row for each cast."""
    if not casts:
        return []
    columns = ["cast", "result", "closest to centre", "at", "speed", "direction"]
    columns += ["E before", "E after", "distance before", "distance after"]
    columns.append("frames read")
    rows = []
    for number, cast in casts:
        verdict, readings = cast.verdict, cast.points.readings
        fit: list[Any] = [Cell("not estimated", "missing"), "", "", ""]
        if cast.estimate is not None:
            fit = number_cells(_fit_quality(cast.estimate.fit.iloc[0]))
        speed = direction = "–"
        if np.isfinite(verdict.speed):
            speed = f"{verdict.speed:.1f} m/s"
            direction = f"{np.degrees(verdict.direction):.0f}°"
        closest = number_cells(
            [format_mm(verdict.distance), format_ms(verdict.t), speed, direction]
        )
        read = number_cell(f"{readings['valid'].sum()} of {len(readings)}")
        rows.append(
            [link(f"#cast-{number}", number), result_badge(cast), *closest, *fit, read]
        )
    return [_tiles(record), table_card(columns, rows)]


def _fit_quality(fit: Any) -> list[str]:
    """Format matching rate and rms distance of an estimation, before and after each."""
    rates = [format_rate(fit["before"]), format_rate(fit["after"])]
    return [*rates, format_mm(fit["rms_before"], 1), format_mm(fit["rms_after"], 1)]


def _tiles(record: RunRecord) -> Tiles:
    verdicts = [c.verdict for c in record.casts if np.isfinite(c.verdict.distance)]
    best = min(
        verdicts, key=lambda verdict: (not verdict.hit, verdict.distance), default=None
    )
    distance, meaning = (
        NOT_KNOWN,
        "closest distance of the tip: it was read in no frame",
    )
    if best:
        distance = format_mm(best.distance)
        meaning = "closest distance of the tip to the target's centre"
        meaning += " in the best cast" if len(record.casts) > 1 else ""
        readings = pd.concat([cast.points.readings for cast in record.casts])
        share = format_percent(readings["valid"].mean())
        meaning += f"; the string was read in {share} of the frames"
    rates = sizes = "not estimated"
    mesh_error_m = 0.0
    if record.estimates:
        rate_before, rate_after, before, after = _fit_quality(
            record.estimates[-1].fit.iloc[0]
        )
        rates, sizes = f"{rate_before} → {rate_after}", f"{before} → {after}"
        mesh_error_m = record.estimates[-1].mesh_error_m
    rate_meaning = (
        "matching rate E of the last cast, before and after estimation (1 is perfect)"
    )
    size_meaning = "rms distance of simulated and measured string, before and after"
    if mesh_error_m:
        mesh_error = format_mm(mesh_error_m, 1)
        size_meaning += (
            f"; without the error of the mesh, {mesh_error}, which charts include"
        )
    return Tiles([(distance, meaning), (rates, rate_meaning), (sizes, size_meaning)])


def hand_paths_figure(record: RunRecord) -> Figure:
    """Draw the hand path of each cast."""
    caption = (
        "As the arm measured it; the last cast is the darkest. The square is the arm's "
        "base."
    )
    picture = hand_paths_picture(record)
    return Figure("Hand path, cast by cast", picture, caption, NO_JOINT_ANGLES)


def result_badge(cast: CastRecord) -> Markup:
    """Mark a cast as hit or missed, unless its trial is not valid."""
    if cast.is_valid:
        return hit_badge(cast.verdict.hit)
    return Markup('<span class="badge">not valid</span>')
