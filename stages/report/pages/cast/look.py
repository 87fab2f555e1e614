"""The section of the look at the string before the first cast."""

from __future__ import annotations

import numpy as np

from stringcast.data.artifacts import JOINTS
from stringcast.stages.model.extension import extend_model
from stringcast.stages.report.charts.camera import ImageRegion
from stringcast.stages.report.formatting import sentence_markup
from stringcast.stages.report.pages.cast.parameters import parameter_table
from stringcast.stages.report.pages.cast.shared_parts import (
    FILM_LAYERS,
    animation_card,
    cause_table,
    distance_part,
    matching_part,
)
from stringcast.stages.report.parts import Card, Container, Explore, Part, Section, Text
from stringcast.stages.report.records import CastRecord, RunRecord

LOOK_ANCHOR = "look"


def look_section(record: RunRecord, look: CastRecord, region: ImageRegion) -> Section:
    """Show the slow trial before the first cast, and its estimate."""
    parts: list[Part] = [Text(_describe_look(record, look))]
    if look.estimate is not None:
        parts.append(Text(sentence_markup(look.estimate.fit["sentence"].iloc[0])))
        model = extend_model(record.model, look.estimate.values())
        parts.append(Card("", [parameter_table(model, look.estimate)]))
    beside: list[Part] = []
    if look.explanation is not None:
        causes = cause_table(look.explanation)
        words = Text(look.explanation.sentence)
        beside.append(Card("Cause", [part for part in (words, causes) if part]))
    beside.append(matching_part(look.estimate, look))
    beside.append(distance_part(record, look))
    columns = [animation_card(record, look, region), Container("column", beside)]
    parts.append(Explore([Container("grid", columns)], FILM_LAYERS))
    return Section("Look at the string", parts, LOOK_ANCHOR)


def _describe_look(record: RunRecord, look: CastRecord) -> str:
    """Describe the slow trial, and the hit probability with its estimate."""
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
        sentences.append("Nothing was estimated from it.")
    elif np.isfinite(chance):
        sentences.append(
            "With this estimate, the predicted hit probability of cast 1 was "
            f"{chance:.2f}."
        )
    return " ".join(sentences)
