"""Parts shared by the sections of a cast and of a look."""

from __future__ import annotations

import numpy as np

from stringcast.data.estimates import Estimate
from stringcast.data.explanations import MIN_SHOWN_PROBABILITY, Explanation
from stringcast.stages.common import describe_causes
from stringcast.stages.report.charts.camera import ImageRegion, cast_film_data
from stringcast.stages.report.charts.cast import (
    distance_chart,
    mark_movement,
    matching_chart,
)
from stringcast.stages.report.formatting import format_mm
from stringcast.stages.report.parts import (
    Card,
    FilmPlayer,
    Layer,
    Part,
    TableView,
    Text,
    number_cells,
)
from stringcast.stages.report.records import CastRecord, RunRecord
from stringcast.stages.report.theme import FRAME_COLOURS

NOTHING_READ = "No frame of this cast could be read, so there is no comparison."
NO_FRAMES = "This cast has no camera frames."
FILM_LAYERS = [
    Layer("before", FRAME_COLOURS["before"]),
    Layer("after", FRAME_COLOURS["after"]),
    Layer("measured", FRAME_COLOURS["measured"], dots=True),
]


def animation_card(record: RunRecord, cast: CastRecord, region: ImageRegion) -> Card:
    """Animate the frames, if any, with the measured and simulated strings."""
    film = cast_film_data(record, cast, region)
    if film is None:
        return missing_card("Animation", NO_FRAMES)
    span = f"{len(film['t'])} camera frames from {film['t'][0]} to {film['t'][-1]} ms"
    words = f"Animation of {span} with the measured and simulated strings"
    return Card("Animation", [FilmPlayer(film, words)])


def distance_part(record: RunRecord, cast: CastRecord) -> Part:
    """Chart the distance between the strings over time, or state why there is none."""
    chart = distance_chart(record, cast)
    return chart or missing_card("Distance over time", NOTHING_READ)


def matching_part(
    estimate: Estimate | None,
    cast: CastRecord | None = None,
    title: str = "Matching rate over time",
) -> Part:
    """Chart E over time, with the movement of a cast, or state why there is no E."""
    if chart := matching_chart(estimate, title):
        return mark_movement(chart, cast) if cast else chart
    cause = "This estimation compared no masks" if estimate else "Nothing was estimated"
    return missing_card(title, f"{cause}, so there is no matching rate.")


def cause_table(explanation: Explanation) -> TableView | None:
    """Tabulate the probable causes; None without any."""
    table = explanation.explanations
    rows = []
    for cause in table[table["probability"] >= MIN_SHOWN_PROBABILITY].itertuples():
        name = describe_causes(str(cause.effects).split())
        tip = format_mm(cause.tip_rms, 1)
        if np.isnan(cause.tip_rms):
            tip = "on a coarse mesh"
        rows.append([name, *number_cells([f"{cause.probability:.2f}", tip])])
    if explanation.untried_probability >= MIN_SHOWN_PROBABILITY:
        untried = f"{explanation.untried_probability:.2f}"
        rows.append(["not compared for lack of time", *number_cells([untried, ""])])
    return (
        TableView(("cause", "probability", "misfit of the tip"), rows) if rows else None
    )


def missing_card(title: str, reason: str) -> Card:
    """State why a part of the page is missing."""
    return Card(title, [Text(reason, "missing")])
