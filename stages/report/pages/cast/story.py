"""The first table of an adaptive run: predicted, happened, why, and what follows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from stringcast.data.explanations import PARTLY_EXPLAINED, Explanation
from stringcast.stages.common import describe_causes
from stringcast.stages.report.formatting import format_hit_probability, format_mm
from stringcast.stages.report.pages.cast.look import LOOK_ANCHOR
from stringcast.stages.report.parts import Card, TableView, link
from stringcast.stages.report.records import CastRecord, RunRecord

COLUMNS = ("", "predicted", "what happened", "why", "what next")


def story_card(
    record: RunRecord, casts: Sequence[tuple[int, CastRecord]]
) -> Card | None:
    """State for each trial what was predicted and happened, why, and what follows.

    Returns None if the run searches for no causes.
    """
    if not any(cast.explanation is not None for _, cast in casts):
        return None
    rows = []
    if record.look is not None:
        rows.append(
            [
                link(f"#{LOOK_ANCHOR}", "Look"),
                "nothing: the string was unknown",
                "the arm swung the string slowly",
                describe_reason(record.look),
                describe_next_plan(record.look, record.casts[0]),
            ]
        )
    for number, cast in casts:
        if number < len(casts):
            following = describe_next_plan(cast, record.casts[number])
        elif record.hit:
            following = "nothing: the target is hit"
        else:
            following = "no casts are left; the commands below go on"
        rows.append(
            [
                link(f"#cast-{number}", f"Cast {number}"),
                describe_prediction(cast),
                describe_result(cast),
                describe_reason(cast),
                following,
            ]
        )
    return Card("What happened, and why", [TableView(COLUMNS, rows)])


def describe_prediction(cast: CastRecord) -> str:
    """State the predicted hit probability of a cast."""
    probability = format_hit_probability(cast.motion.outcome.iloc[0])
    if not probability:
        return "no probability was predicted"
    return f"a hit, with probability {probability}"


def describe_result(cast: CastRecord) -> str:
    """State whether a cast hit, and whether it agreed with its prediction."""
    if not cast.is_valid:
        return "the trial is not valid"
    result = "hit" if cast.verdict.hit else "missed"
    if np.isfinite(cast.verdict.distance):
        distance = format_mm(cast.verdict.distance)
        result += f", {distance} from the target's centre"
    if cast.surprise is None or np.isnan(cast.surprise.p_value):
        return result
    judgement = "a surprise" if cast.surprise.is_surprising else "no surprise"
    return f"{result}; the path was {judgement} (p = {cast.surprise.p_value:.2g})"


def describe_reason(trial: CastRecord) -> str:
    """State the causes that were found after a trial."""
    if trial.explanation is None:
        return "nothing was estimated from this trial"
    return trial.explanation.sentence


def describe_next_plan(trial: CastRecord, following: CastRecord) -> str:
    """State the model and the correction with which the next cast was planned."""
    words = describe_planned_model(trial.explanation)
    plan: Any = following.motion.outcome.iloc[0]
    if plan.get("correction", 0.0) > 0:
        words += f", and the last miss corrected by {format_mm(plan['correction'], 1)}"
    return words


def describe_planned_model(explanation: Explanation | None) -> str:
    """Describe the model of the next plan."""
    if explanation is None:
        return "a cast with the earlier estimate"
    if explanation.named_causes:
        return f"a cast with {describe_causes(explanation.named_causes)} in the model"
    if explanation.verdict in PARTLY_EXPLAINED:
        return "a cast that allows for the misfit that is not explained"
    if explanation.verdict == "candidates":
        return "a cast that allows for each of the probable causes"
    return "a cast with the new estimate"
