"""The page of a run with casts, or of an estimation from stored trials."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup
from matplotlib import style

from stringcast.stages.common import MM_PER_M
from stringcast.stages.model.target import Target
from stringcast.stages.report.charts.camera import region_of_run
from stringcast.stages.report.charts.cast import distance_scale_end
from stringcast.stages.report.formatting import format_mm
from stringcast.stages.report.page import Page
from stringcast.stages.report.pages.cast.look import LOOK_ANCHOR, look_section
from stringcast.stages.report.pages.cast.parameters import parameters_section
from stringcast.stages.report.pages.cast.single_cast import cast_section
from stringcast.stages.report.pages.cast.story import story_card
from stringcast.stages.report.pages.cast.summary import (
    hand_paths_figure,
    result_badge,
    summary_parts,
)
from stringcast.stages.report.parts import Part, join_sentences
from stringcast.stages.report.records import RunRecord
from stringcast.stages.report.theme import STYLE_SHEET


def cast_page(record: RunRecord) -> str:
    """Render the page of a run."""
    casts = list(enumerate(record.casts, start=1))
    with style.context(STYLE_SHEET):
        sections: list[Part] = []
        if story := story_card(record, casts):
            sections.append(story)
        sections += [*summary_parts(record, casts), parameters_section(record)]
        if len(casts) > 1:
            sections.append(hand_paths_figure(record))
        if casts:
            region, scale_end = region_of_run(record), distance_scale_end(record)
            if record.look is not None:
                sections.append(look_section(record, record.look, region))
            for number, cast in casts:
                sections.append(cast_section(record, number, cast, region, scale_end))
    is_valid = any(cast.is_valid for cast in record.casts)
    tone = "good" if record.hit else "bad"
    nav = []
    for number, cast in casts:
        words = join_sentences([f"Cast {number}", result_badge(cast)])
        nav.append((f"cast-{number}", words))
    if record.look is not None:
        nav.insert(0, (LOOK_ANCHOR, Markup("Look")))
    page = Page(
        kind="report",
        name=record.name,
        heading=record.sentence,
        lead=_describe_task(record),
        sections=sections,
        origin=record.provenance,
        settings=record.settings,
        tone=tone if is_valid else "",
        nav=nav if len(nav) > 1 else (),
        following=record.next_commands,
    )
    return str(page)


def _describe_task(record: RunRecord) -> str:
    """Describe string and target in a sentence."""
    string = f"A string of {format_mm(record.model.string.length)}"
    if not record.casts:
        return f"{string}."
    target = record.target
    size = f"{round(target.w * MM_PER_M, 1):g} × {round(target.h * MM_PER_M, 1):g} mm"
    return (
        f"{string}, and a target box of {size} around ({target.x * MM_PER_M:.0f}, "
        f"{target.y * MM_PER_M:.0f}) mm, where x points to the right and y up from the "
        f"world's origin.{_describe_arrival(target)}"
    )


def _describe_arrival(target: Target) -> str:
    """Describe the wanted arrival; empty if any direction and speed will do."""
    wanted = []
    if target.direction is not None:
        angle = np.degrees([target.direction, target.direction_tolerance])
        wanted.append(f"in direction {angle[0]:.0f} ± {angle[1]:.0f}°")
    if target.speed is not None:
        wanted.append(f"at {target.speed:.3g} ± {target.speed_tolerance:.2g} m/s")
    return f" The tip should arrive {' and '.join(wanted)}." if wanted else ""
