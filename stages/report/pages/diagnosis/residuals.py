"""The sections on the misfit: residual maps, and trials side by side."""

from __future__ import annotations

from stringcast.stages.common import rms
from stringcast.stages.report.charts.residual import (
    MODEL_COLOURS,
    model_labels,
    residual_charts,
    residual_maps,
    trial_rms_picture,
)
from stringcast.stages.report.charts.string_film import string_film_data, worst_frame
from stringcast.stages.report.formatting import format_mm, format_ms, join_effects
from stringcast.stages.report.pages.diagnosis.verdict import verdict_tiles
from stringcast.stages.report.parts import (
    Card,
    Container,
    Explore,
    Figure,
    FilmPlayer,
    Jump,
    Layer,
    Part,
    Section,
    Text,
)
from stringcast.stages.report.records import DiagnosisRecord, model_distances
from stringcast.stages.report.theme import MS_PER_S

NOTHING_MEASURED = "Nothing was measured that could be compared."
MAP_CAPTION = (
    "Arc length s from the grasp, over time; a row for each trial. Orange: the "
    "measured string lies to the left of the simulated one, or further towards the "
    "tip; blue: the opposite. Faint colours are noise. A patch of colour is an error "
    "of the model, or numerical error in chaotic motion. Grey: not measured. A row "
    "ends with its trial. All maps share the colours."
)
TRIALS_LEAD = (
    "Point at a curve to show all strings at that time; drag to zoom, double click to "
    "zoom out. Keyboard: arrows, + and −, 0. Faint lines are the paths of the tips. "
    "Each trial starts at the largest misfit of the base model."
)


def opening_part(record: DiagnosisRecord) -> Part:
    """Animate the trial with the largest misfit, with and without the causes."""
    trials = record.drawn_trials
    tiles = verdict_tiles(record)
    if not trials:
        return tiles
    largest = {
        name: model_distances(rows, "base").max() for name, rows in trials.items()
    }
    name = max(largest, key=lambda trial: largest[trial])
    words = f"The string in trial {name} over time, measured and simulated."
    film = FilmPlayer(string_film_data(record, trials[name]), words)
    _, tip = residual_charts(record, trials[name])
    opening = Card(f"Trial {name}, slowed down", [film])
    return Explore(
        [Container("grid", [opening, Container("column", [tip, tiles])])],
        film_layers(record),
        times=True,
        plays=True,
    )


def film_layers(record: DiagnosisRecord) -> list[Layer]:
    """Return the layers of a film: a string for each model, and the measured one."""
    simulated = [
        Layer(model, MODEL_COLOURS[model], label=label)
        for model, label in model_labels(record).items()
    ]
    return [*simulated, Layer("measured", "measured", dots=True)]


def misfit_section(record: DiagnosisRecord) -> Section:
    """Show residuals over arc length and time, and their size trial by trial."""
    figures = []
    for model in record.models:
        maps = residual_maps(record, model)
        figures.append(
            Figure(f"Residual maps: {model} model", maps, MAP_CAPTION, NOTHING_MEASURED)
        )
    caption = "Dots beyond the bar exceed noise and numerical error."
    sizes = trial_rms_picture(record)
    figures.append(Figure("Residual by trial", sizes, caption, NOTHING_MEASURED))
    texts = [Text(words) for words in _describe_models(record)]
    return Section("Misfit of the simulation", [*texts, Container("grid", figures)])


def _describe_models(record: DiagnosisRecord) -> list[str]:
    """Describe the drawn models and trials."""
    lead = (
        "The base model is the configured one with its parameters fitted to these "
        "trials, so no choice of parameters removes its misfit."
    )
    if record.is_extended and record.added_effects:
        added = join_effects(record.added_effects)
        lead += f" The extended model adds {added} and is fitted to the same trials."
    drawn, used = len(record.drawn_trials), len(record.document["trials"]["used"])
    if drawn < used:
        lead += f" Drawn are the {drawn} of {used} trials with the largest misfit."
    is_resolution = record.document["verdict"] == "effect" and not record.is_extended
    if not is_resolution or record.diagnosis.causes.empty:
        return [lead]
    finer, configured = record.extension["string"]["points"], record.model.string.points
    maps = (
        f"The maps are those of {finer} mass points instead of {configured}; this "
        "removes the misfit."
    )
    return [lead, maps]


def trials_section(record: DiagnosisRecord) -> Section | None:
    """Show trials side by side on one clock: the strings, and their residuals."""
    if not record.drawn_trials:
        return None
    cards = []
    for trial, table in record.drawn_trials.items():
        frame = worst_frame(table)
        t = float(frame["t"].iloc[0])
        sizes = []
        for model in record.models:
            sizes.append(f"{model} {format_mm(rms(model_distances(frame, model)), 1)}")
        words = f"The string in trial {trial} over time, measured and simulated."
        parts: list[Part] = [
            FilmPlayer(string_film_data(record, table), words),
            Jump(t * MS_PER_S, f"Largest misfit at {format_ms(t)}: {', '.join(sizes)}"),
            *residual_charts(record, table),
        ]
        cards.append(Card(trial, parts))
    explore = Explore([Container("trials", cards)], film_layers(record), times=True)
    return Section("Trials side by side", [Text(TRIALS_LEAD), explore], "trials")
