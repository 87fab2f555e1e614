"""What the simulation gets wrong: residual maps, and trials side by side."""

from __future__ import annotations

import numpy as np

from stringcast.stages.report.charts.residual import curves, maps, size, tip_curves
from stringcast.stages.report.charts.string import film, last, worst
from stringcast.stages.report.charts.time import latent
from stringcast.stages.report.formatting import enumerated, mm, ms, plain
from stringcast.stages.report.page import (
    Card,
    Explore,
    Figure,
    Film,
    Grid,
    Jump,
    Layer,
    Part,
    Section,
    Side,
    Text,
)
from stringcast.stages.report.records import DiagnosisRecord, away
from stringcast.stages.report.theme import MM_PER_M

NOTHING = "Nothing was measured that could be compared."


def wrong(record: DiagnosisRecord) -> Section:
    """Residuals over arc length and time, trial by trial; the strings where they are
    worst; the way of the tip.
    """
    about = (
        "Arc length s from the grasp, over time; one row for each trial. Orange: the measured string lies to the left "
        "of the simulated one, or further towards the tip; blue: the other way. Faint is noise; a patch of colour is a "
        "mistake of the model, or of its arithmetic where the string moves so violently that small errors grow. Grey: "
        "not measured. The colours mean the same in all maps."
    )
    much = "Dots beyond the bar are more than noise and the simulation's own error account for."
    where = [
        Figure(f"Residual maps: {side} model", maps(record, side), about, NOTHING)
        for side in record.models
    ]
    parts: list[Part] = [
        *map(Text, _compared(record)),
        Grid([*where, Figure("Error by trial", size(record), much, NOTHING)]),
    ]
    return Section("What the simulation gets wrong", parts)


def trials(record: DiagnosisRecord) -> Section | None:
    """Trials side by side, to play: the string, and how far from it the models are; all
    on one clock.
    """
    if not record.trials:
        return None
    layers = [
        Layer("base", "before"),
        Layer("extended", "after"),
        Layer("measured", "measured", dots=True),
    ]
    shown = [layer for layer in layers if layer.name in (*record.models, "measured")]
    lead = "Point at a curve, and every trial shows its string at that time; drag to zoom, double click for the "
    lead += "whole. With the keyboard: arrows, + and −, 0. Faint lines are the ways of the tips. Each begins in the "
    lead += "frame that the base model gets most wrong."
    cards = []
    for trial, table in record.trials.items():
        frame = worst(table)
        moment = float(frame["t"].iloc[0])
        off = ", ".join(
            f"{m} {mm(float(np.sqrt(np.mean(away(frame, m) ** 2))), 1)}"
            for m in record.models
        )
        played = Film(
            film(record, table),
            f"The string in trial {trial} over time, measured and simulated.",
        )
        jump = Jump(moment * MM_PER_M, f"Most wrong at {ms(moment)}: {off} off")
        charts = [
            curves(record, trial),
            tip_curves(record, trial, last(table)),
            latent(record, trial),
        ]
        cards.append(Card(trial, [played, jump, *(chart for chart in charts if chart)]))
    return Section(
        "Trials side by side",
        [Text(lead), Explore([Side(cards)], shown, times=True)],
        "trials",
    )


def _compared(record: DiagnosisRecord) -> list[str]:
    """Which models and trials are drawn."""
    document, extended = record.document, len(record.models) > 1
    lead = "The base model is the configured one with its parameters fitted to these trials, so what it gets wrong no "
    lead += "choice of parameters mends."
    if extended:
        added = enumerated([plain(name) for name in record.extension["effects"]])
        lead += f" The extended model adds {added} and is fitted to the same trials."
    if len(record.trials) < len(document["trials"]["used"]):
        lead += f" Drawn are the {len(record.trials)} trials of {len(document['trials']['used'])} that the base model gets "
        lead += "most wrong."
    if document["verdict"] != "effect" or extended or record.diagnosis.causes.empty:
        return [lead]
    points = record.extension["string"]["points"], record.model.string.points
    return [
        lead,
        f"The maps are those of {points[0]} mass points in place of {points[1]}; with these, the misfit is gone.",
    ]
