"""The page of casts, and of estimation alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup
from matplotlib import style

from stringcast.data.artifacts import (
    JOINTS,
    MIN_SHOWN_PROBABILITY,
    Estimate,
    Explanation,
    Surprise,
)
from stringcast.stages.common import MM_PER_M, describe_causes, readable_name
from stringcast.stages.extract.reading_report import describe_arm_misfit
from stringcast.stages.model.extension import extend_model
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import Parameter
from stringcast.stages.model.target import Target
from stringcast.stages.report.charts.camera import (
    ImageRegion,
    cast_film_data,
    closest_approach_picture,
    region_of_run,
)
from stringcast.stages.report.charts.cast import (
    cast_path_picture,
    distance_chart,
    distance_map,
    distance_scale_end,
    hand_paths_picture,
    history_picture,
    joint_charts,
    mark_movement,
    matching_chart,
)
from stringcast.stages.report.formatting import (
    NOT_KNOWN,
    format_interval,
    format_mm,
    format_ms,
    format_percent,
    format_rate,
    format_value,
    sentence_markup,
    symbol_markup,
    unit_markup,
)
from stringcast.stages.report.page import (
    Card,
    Cell,
    Container,
    Explore,
    Figure,
    FilmPlayer,
    Key,
    Layer,
    Page,
    Part,
    Section,
    Small,
    TableView,
    Text,
    Tiles,
    bold_text,
    hit_badge,
    join_sentences,
    link,
    name_value_table,
    number_cell,
    number_cells,
    table_card,
)
from stringcast.stages.report.records import CastRecord, RunRecord
from stringcast.stages.report.theme import FRAME_COLOURS, STYLE_SHEET

NOTHING_READ = "No frame of this cast could be read, so there is no comparison."
NO_JOINT_ANGLES = "The arm reported no joint angles."
NO_FRAMES = "This cast has no camera frames."
OVERLAY_LABELS = {
    "before": "simulated, before estimation",
    "after": "simulated, after",
    "measured": "measured",
    "target": "target",
}


def cast_page(record: RunRecord) -> str:
    """Render the page; the same record gives the same text."""
    casts = list(enumerate(record.casts, start=1))
    with style.context(STYLE_SHEET):
        sections: list[Part] = [*_summary(record, casts), _parameters_section(record)]
        if len(casts) > 1:
            sections.append(_hand_paths_figure(record))
        if casts:
            region, scale_end = region_of_run(record), distance_scale_end(record)
            if record.look is not None:
                sections.append(_look_section(record, record.look, region))
            for number, cast in casts:
                sections.append(_cast_section(record, number, cast, region, scale_end))
    is_valid = any(cast.is_valid for cast in record.casts)
    tone = "good" if record.hit else "bad"
    nav = [
        (f"cast-{n}", join_sentences([f"Cast {n}", _result(cast)])) for n, cast in casts
    ]
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
    """Describe how the tip shall arrive; empty if any direction and speed will do."""
    wanted = []
    if target.direction is not None:
        angle = np.degrees([target.direction, target.direction_tolerance])
        wanted.append(f"in direction {angle[0]:.0f} ± {angle[1]:.0f}°")
    if target.speed is not None:
        wanted.append(f"at {target.speed:.3g} ± {target.speed_tolerance:.2g} m/s")
    return f" The tip shall arrive {' and '.join(wanted)}." if wanted else ""


def _result(cast: CastRecord) -> Markup:
    """Mark a cast as hit or missed, unless its trial is not valid."""
    if cast.is_valid:
        return hit_badge(cast.verdict.hit)
    return Markup('<span class="badge">not valid</span>')


# --- all casts
def _summary(record: RunRecord, casts: list[tuple[int, CastRecord]]) -> list[Part]:
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
            [link(f"#cast-{number}", number), _result(cast), *closest, *fit, read]
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
    distance, meaning = NOT_KNOWN, "how close the tip came: it was read in no frame"
    if best:
        distance = format_mm(best.distance)
        meaning = "closest distance of the tip to the target's centre"
        meaning += " in the best cast" if len(record.casts) > 1 else ""
        readings = pd.concat([cast.points.readings for cast in record.casts])
        share = format_percent(readings["valid"].mean())
        meaning += f"; the string was read in {share} of the frames"
    rates = sizes = "not estimated"
    if record.estimates:
        rate_before, rate_after, before, after = _fit_quality(
            record.estimates[-1].fit.iloc[0]
        )
        rates, sizes = f"{rate_before} → {rate_after}", f"{before} → {after}"
    rate_meaning = (
        "matching rate E of the last cast, before and after estimation (1 is perfect)"
    )
    size_meaning = "rms distance of simulated and measured string, before and after"
    return Tiles([(distance, meaning), (rates, rate_meaning), (sizes, size_meaning)])


def _hand_paths_figure(record: RunRecord) -> Figure:
    caption = (
        "As the arm measured it; the last cast is the darkest. The square is the arm's "
        "base."
    )
    picture = hand_paths_picture(record)
    return Figure("Hand path, cast by cast", picture, caption, NO_JOINT_ANGLES)


# --- parameters of the string
HISTORY_KEY = (
    ("best value; 0 is the start value", "var(--after)"),
    ("● determined", "none"),
    ("○ not determined by the data, or not known to be", "none"),
    ("range searched", "band"),
    ("95 % interval, where the method gives one", "bar"),
)


def _parameters_section(record: RunRecord) -> Section:
    """Show each parameter of the last estimate, and E over time if no cast shows it."""
    title = "Parameters of the string"
    if not record.estimates:
        return Section(title, [Text("Nothing was estimated in this run.", "missing")])
    estimate = record.estimates[-1]
    rows = estimate.parameters.set_index("name")
    model = extend_model(record.model, rows.index)
    parameters = [p for p in model.parameters if p.name in rows.index]
    parts: list[Part] = [Text(sentence_markup(estimate.fit["sentence"].iloc[0]))]
    if len(record.estimates) > 1:
        pictures = []
        for parameter in parameters:
            name = bold_text(readable_name(parameter.name))
            caption = Markup("{} {} <span>[{}]</span>").format(
                symbol_markup(parameter.symbol), name, unit_markup(parameter.unit)
            )
            pictures.append((caption, history_picture(parameter, record.estimates)))
        parts.append(Card("", [Key(HISTORY_KEY), Small(pictures)]))
    parts.append(Card("", [_parameter_table(model, estimate)]))
    if not record.casts:
        charts = []
        for number, estimate in enumerate(record.estimates, start=1):
            chart_title = f"Matching rate over time, estimation {number}"
            charts.append(_matching_part(estimate, title=chart_title))
        parts.append(Explore([Container("grid", charts)]))
    return Section(title, parts)


def _parameter_table(model: Model, estimate: Estimate) -> TableView:
    """Tabulate what an estimate says about each parameter of a model."""
    columns = ("parameter", "", "value", "95 % interval", "range searched", "unit")
    rows = estimate.parameters.set_index("name")
    table = [
        _parameter_row(parameter, rows.loc[parameter.name])
        for parameter in model.parameters
        if parameter.name in rows.index
    ]
    return TableView([*columns, "determined by the data"], table)


def _parameter_row(parameter: Parameter, row: pd.Series) -> list[Any]:
    """Format the estimate of a parameter, and whether the data determine it."""
    value, low, high = format_interval(row["value"], row["low"], row["high"])
    interval = "none" if NOT_KNOWN in (low, high) else f"{low} to {high}"
    determined = "no" if np.isfinite(row["low"]) else NOT_KNOWN
    if row["determined"]:
        determined = "yes"
    if row["at_bound"]:
        determined += ", at the end of its range"
    searched = f"{format_value(row['minimum'])} to {format_value(row['maximum'])}"
    return [
        Cell(readable_name(parameter.name), title=parameter.meaning),
        symbol_markup(parameter.symbol),
        *number_cells([value, interval, searched]),
        unit_markup(parameter.unit),
        determined,
    ]


# --- the look at the string
LOOK_ANCHOR = "look"


def _look_section(record: RunRecord, look: CastRecord, region: ImageRegion) -> Section:
    """Show the slow trial before the first cast, and what it taught of the string."""
    parts: list[Part] = [Text(_describe_look(record, look))]
    if look.estimate is not None:
        parts.append(Text(sentence_markup(look.estimate.fit["sentence"].iloc[0])))
        model = extend_model(record.model, look.estimate.values())
        parts.append(Card("", [_parameter_table(model, look.estimate)]))
    beside: list[Part] = []
    if look.explanation is not None:
        causes = _cause_table(look.explanation)
        words = Text(look.explanation.sentence)
        beside.append(Card("Cause", [part for part in (words, causes) if part]))
    beside.append(_matching_part(look.estimate, look))
    beside.append(_distance_part(record, look))
    animation = Card("Animation", [_animation(record, look, region)])
    columns = [animation, Container("column", beside)]
    parts.append(Explore([Container("grid", columns)], FILM_LAYERS))
    return Section("Look at the string", parts, LOOK_ANCHOR)


def _describe_look(record: RunRecord, look: CastRecord) -> str:
    """Describe the slow trial, and how likely a hit was with what it taught."""
    commands = look.motion.commands
    hand = record.model.arm.joint_positions(commands[list(JOINTS)].to_numpy())[:, -1]
    velocity = np.gradient(hand, commands["t"], axis=0)
    fastest = np.linalg.norm(velocity, axis=-1).max()
    readings = look.points.readings
    sentences = [
        f"Before the first cast the arm swung slowly for {look.motion.duration:.1f} s, "
        f"its hand at {fastest:.2f} m/s at most.",
        f"The string was read in {readings['valid'].sum()} of {len(readings)} frames.",
    ]
    chance = record.casts[0].motion.outcome.iloc[0].get("chance", np.nan)
    if look.estimate is None:
        sentences.append("Nothing was learned from it.")
    elif np.isfinite(chance):
        sentences.append(
            "With the strings that this leaves possible, the predicted hit probability "
            f"of cast 1 was {chance:.2f}."
        )
    return " ".join(sentences)


# --- one cast
FILM_LAYERS = [
    Layer("before", FRAME_COLOURS["before"]),
    Layer("after", FRAME_COLOURS["after"]),
    Layer("measured", FRAME_COLOURS["measured"], dots=True),
]


def _cast_section(
    record: RunRecord,
    number: int,
    cast: CastRecord,
    region: ImageRegion,
    scale_end: float,
) -> Section:
    """Show everything about a cast; all casts share the colour scale of distances."""
    parts: list[Part] = [Text(_describe_cast(cast))]
    if cast.surprise is not None:
        parts.append(_learning_card(cast, cast.surprise))
    if cast.estimate is not None and cast.estimate is not record.estimates[-1]:
        parts.append(Text(sentence_markup(cast.estimate.fit["sentence"].iloc[0])))
    for state, simulated in (("before", cast.before), ("after", cast.after)):
        if not np.isfinite(simulated).all():
            words = (
                f"The simulation with the parameters {state} estimation diverged; it "
                "is not drawn."
            )
            parts.append(Text(words, "missing"))
    compared = _comparison(record, cast, region, scale_end)
    parts.append(Explore(compared, FILM_LAYERS))
    parts.append(Container("grid", [_motions_card(cast), _link_card(cast)]))
    return Section(f"Cast {number}", parts, f"cast-{number}", _result(cast), "cast")


def _learning_card(cast: CastRecord, surprise: Surprise) -> Card:
    """Tell what was predicted, whether the trial surprised, and what explains it."""
    chance = cast.motion.outcome.iloc[0].get("chance", np.nan)
    rows = [
        ("predicted hit probability", f"{chance:.2f}"),
        ("surprise", surprise.sentence),
    ]
    causes = None
    if (explanation := cast.explanation) is not None:
        rows.append(("cause", explanation.sentence))
        causes = _cause_table(explanation)
    parts = [name_value_table(rows), causes]
    return Card("Prediction, surprise and cause", [part for part in parts if part])


def _cause_table(explanation: Explanation) -> TableView | None:
    """Tabulate the causes that are probable enough to be shown; None without any."""
    table = explanation.explanations
    rows = []
    for cause in table[table["probability"] >= MIN_SHOWN_PROBABILITY].itertuples():
        name = describe_causes(str(cause.effects).split())
        tip = format_mm(cause.tip_rms, 1)
        if np.isnan(cause.tip_rms):
            tip = "on a coarse mesh"
        rows.append([name, *number_cells([f"{cause.probability:.2f}", tip])])
    return TableView(("cause", "probability", "tip is off by"), rows) if rows else None


def _comparison(
    record: RunRecord, cast: CastRecord, region: ImageRegion, scale_end: float
) -> list[Part]:
    """Compare simulation and film: closest approach, animation, time and paths."""
    near: Part = _reason("Closest approach", NO_FRAMES)
    if picture := closest_approach_picture(record, cast):
        caption = (
            "The camera frame nearest in time. Dashed: the path of the tip 30 ms "
            "before and after. Ring: its closest approach."
        )
        colours = [(words, FRAME_COLOURS[k]) for k, words in OVERLAY_LABELS.items()]
        key = Key(colours)
        near = Figure("Closest approach", picture, caption, beside=key)
    distance = Figure(
        "Distance of simulated and measured string",
        distance_map(record, cast, scale_end),
        "Over arc length and time, after estimation; gaps are frames that could not be "
        "read. All casts share the colour scale.",
        NOTHING_READ,
    )

    # charts grow, so that both columns have one height
    animation = Card("Animation", [_animation(record, cast, region)])
    columns = [
        Container("column", [near, distance, _matching_part(cast.estimate, cast)]),
        Container("column", [animation, _distance_part(record, cast)]),
    ]

    # the joints together are as high as the hand's path beside them
    paths = Figure(
        "Paths of hand and tip",
        cast_path_picture(record, cast),
        "As measured. Grey: the arm at the start (faint) and at the closest approach.",
        NO_JOINT_ANGLES,
    )
    joints: Part = _reason("Joint angles", NO_JOINT_ANGLES)
    if len(cast.trial.arm):
        joints = Container("column", joint_charts(cast))
    return [Container("grid", columns), Container("grid", [paths, joints])]


def _animation(record: RunRecord, cast: CastRecord, region: ImageRegion) -> Part:
    """Animate frames with the measured and simulated strings, if there are any."""
    film = cast_film_data(record, cast, region)
    if film is None:
        return Text(NO_FRAMES, "missing")
    span = f"{len(film['t'])} camera frames from {film['t'][0]} to {film['t'][-1]} ms"
    words = f"Animation of {span} with the measured and simulated strings"
    return FilmPlayer(film, words)


def _distance_part(record: RunRecord, cast: CastRecord) -> Part:
    """Chart the distance of the strings over time, or state that none was read."""
    chart = distance_chart(record, cast)
    return chart or _reason("Distance over time", NOTHING_READ)


def _matching_part(
    estimate: Estimate | None,
    cast: CastRecord | None = None,
    title: str = "Matching rate over time",
) -> Part:
    """Chart E over time, with the movement of a cast, or state why there is no E."""
    if chart := matching_chart(estimate, title):
        return mark_movement(chart, cast) if cast else chart
    cause = "This estimation compared no masks" if estimate else "Nothing was estimated"
    return _reason(title, f"{cause}, so there is no matching rate.")


def _reason(title: str, reason: str) -> Card:
    """State why a part of the page is missing."""
    return Card(title, [Text(reason, "missing")])


def _describe_cast(cast: CastRecord) -> Markup:
    """Describe the result of a cast in sentences."""
    verdict, plan = cast.verdict, cast.motion.outcome.iloc[0]
    if np.isfinite(verdict.distance):
        sentences = [
            f"The tip came within {format_mm(verdict.distance)} of the target's "
            f"centre, at {format_ms(verdict.t)} of a movement of "
            f"{format_ms(plan['duration'])}.",
            f"The simulation predicted {format_ms(plan['t_hit'])}.",
        ]
        if np.isfinite(plan.get("chance", np.nan)):
            chance, low, high = plan[["chance", "chance_low", "chance_high"]]
            sentences.append(
                f"The predicted hit probability was {chance:.2f} ({low:.2f} to "
                f"{high:.2f})."
            )
            if plan.get("prospects"):
                sentences.append(f"Stated before the cast: {plan['prospects']}")
    else:
        reason = "there are no frames"
        if len(cast.points.readings):
            reason = "no frame shows the string clearly enough"
        sentences = [f"The tip was not read in this cast: {reason}."]
    misfit = describe_arm_misfit(cast.points.readings)
    if misfit:
        sentences.append(misfit)
    if verdict.touched:
        sentences.append(
            f"The string touched an obstacle in {verdict.touched} frame(s). Nothing is "
            "learned from its motion after that, and the simulation ignores obstacles."
        )
    return join_sentences(sentences)


def _motions_card(cast: CastRecord) -> Card:
    """List what became of the motions that the search tried."""
    tried: Part = Text("The number of tried motions was not recorded.", "missing")
    if not cast.motion.attempts.empty:
        ranked = cast.motion.attempts.sort_values("count", ascending=False)
        outcomes = zip(ranked["outcome"], ranked["count"], strict=True)
        rows = [(outcome, number_cell(count)) for outcome, count in outcomes]
        tried = TableView(("outcome", "motions"), rows)
    parts = [tried]
    plan = cast.motion.outcome.iloc[0]
    if np.isfinite(plan.get("likeness", np.nan)):
        parts.append(
            Text(
                f"Where the tip is to hit, its error has a correlation of "
                f"{plan['likeness']:.2f} with that of the last cast. The prediction is "
                f"corrected by {format_mm(plan['correction'], 1)}."
            )
        )
    return Card("Motions tried until one was chosen", parts)


def _link_card(cast: CastRecord) -> Card:
    """Report commands and frames that were late, lost or not read."""
    report, readings = cast.trial.link.iloc[0], cast.points.readings
    unread = readings[~readings["valid"].astype(bool)]
    result = "Arm and camera kept their time limits."
    if not report["valid"]:
        result = Markup('<b class="bad">This trial is not valid:</b> {}.')
        result = result.format(report["reason"])
    rows = {
        "commands sent": report["ticks"],
        "late or lost": report["missed"],
        "lateness: median, 99 %, largest": _lateness(report, "jitter"),
        "frames filmed": len(readings),
    }
    if "frames_due" in report:  # only cameras that report when each frame was due
        rows |= {
            "frames due": report["frames_due"],
            "frames dropped": report["frames_dropped"],
            "frames repeated": report["frames_repeated"],
            "frames late": report["frames_late"],
            "frames per second": f"{report['fps']:.2f}",
            "lateness of frames: median, 99 %, largest": _lateness(
                report, "frame_jitter"
            ),
        }
    for reason, count in unread["reason"].value_counts(sort=False).items():
        rows[f"frames not read: {reason}"] = count
    cells = [(name, number_cell(value)) for name, value in rows.items()]
    parts: list[Part] = [Text(result, ""), name_value_table(cells)]
    if report.get("remarks"):
        parts.append(Text(f"Not verified: {report['remarks']}.", ""))
    return Card("Timing and frames", parts)


def _lateness(report: Any, prefix: str) -> str:
    quantiles = ("p50", "p99", "max")
    return ", ".join(format_ms(report[f"{prefix}_{name}"], 2) for name in quantiles)
