"""The section of one cast: prediction, film and estimate."""

from __future__ import annotations

from typing import Any

import numpy as np
from markupsafe import Markup

from stringcast.data.explanations import Surprise
from stringcast.stages.extract.reading_report import describe_arm_misfit
from stringcast.stages.report.charts.camera import ImageRegion, closest_approach_picture
from stringcast.stages.report.charts.cast import (
    cast_path_picture,
    distance_map,
    joint_charts,
)
from stringcast.stages.report.formatting import (
    format_hit_probability,
    format_mm,
    format_ms,
    sentence_markup,
)
from stringcast.stages.report.pages.cast.shared_parts import (
    FILM_LAYERS,
    NO_FRAMES,
    NOTHING_READ,
    animation_card,
    cause_table,
    distance_part,
    matching_part,
    missing_card,
)
from stringcast.stages.report.pages.cast.summary import NO_JOINT_ANGLES, result_badge
from stringcast.stages.report.parts import (
    Card,
    Container,
    Explore,
    Figure,
    Key,
    Part,
    Section,
    TableView,
    Text,
    join_sentences,
    name_value_table,
    number_cell,
)
from stringcast.stages.report.records import CastRecord, RunRecord
from stringcast.stages.report.theme import FRAME_COLOURS

OVERLAY_LABELS = {
    "before": "simulated, before estimation",
    "after": "simulated, after",
    "measured": "measured",
    "target": "target",
}


def cast_section(
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
    return Section(
        f"Cast {number}", parts, f"cast-{number}", result_badge(cast), "cast"
    )


def _learning_card(cast: CastRecord, surprise: Surprise) -> Card:
    """Show the predicted hit probability, the surprise, and its causes."""
    chance = cast.motion.outcome.iloc[0].get("chance", np.nan)
    rows = [
        ("predicted hit probability", f"{chance:.2f}"),
        ("surprise", surprise.sentence),
    ]
    causes = None
    if (explanation := cast.explanation) is not None:
        rows.append(("cause", explanation.sentence))
        causes = cause_table(explanation)
    parts = [name_value_table(rows), causes]
    return Card("Prediction, surprise and cause", [part for part in parts if part])


def _comparison(
    record: RunRecord, cast: CastRecord, region: ImageRegion, scale_end: float
) -> list[Part]:
    """Compare simulation and film: closest approach, animation, time and paths."""
    near: Part = missing_card("Closest approach", NO_FRAMES)
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

    # charts grow, so that both columns have the same height
    animation = animation_card(record, cast, region)
    columns = [
        Container("column", [near, distance, matching_part(cast.estimate, cast)]),
        Container("column", [animation, distance_part(record, cast)]),
    ]

    # the joint charts together are as high as the paths on their left
    paths = Figure(
        "Paths of hand and tip",
        cast_path_picture(record, cast),
        "As measured. Grey: the arm at the start (faint) and at the closest approach.",
        NO_JOINT_ANGLES,
    )
    joints: Part = missing_card("Joint angles", NO_JOINT_ANGLES)
    if len(cast.trial.arm):
        joints = Container("column", joint_charts(cast))
    return [Container("grid", columns), Container("grid", [paths, joints])]


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
        if probability := format_hit_probability(plan):
            sentences.append(f"The predicted hit probability was {probability}.")
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
            f"The string touched an obstacle in {verdict.touched} frame(s). Its later "
            "motion is not used, and the simulation ignores obstacles."
        )
    return join_sentences(sentences)


def _motions_card(cast: CastRecord) -> Card:
    """List the outcomes of the motions that the search tried."""
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
                f"At the planned hit, the tip's error has a correlation of "
                f"{plan['likeness']:.2f} with that of the last cast. The prediction is "
                f"corrected by {format_mm(plan['correction'], 1)}."
            )
        )
    return Card("Motions tried until one was chosen", parts)


def _link_card(cast: CastRecord) -> Card:
    """Report late and lost commands, and late, lost and unread frames."""
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
