"""Align: measure pose and clock of the camera relative to the arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
import yaml
from pydantic import PositiveFloat

from stringcast.data.alignment import (
    ALIGNMENT_SUMMARY,
    MEASURED_PARAMETERS,
    SIGHTINGS,
    Alignment,
)
from stringcast.data.artifacts import Film, Observation, TrialSet
from stringcast.data.file_checks import mark_yaml_end
from stringcast.data.schema import DataError
from stringcast.stages.align.acceptance import refuse_fit, refuse_sight
from stringcast.stages.align.fit import (
    CANDIDATE_EFFECTS,
    REQUIRED_EFFECTS,
    AlignmentFit,
    AlignmentProblem,
    add_effects,
    measurement_model,
    select_effects,
)
from stringcast.stages.align.grasp import grasp_sightings
from stringcast.stages.align.lookalike import (
    LAG,
    OFFSET,
    largest_hidden_lag,
    likelihood_profile,
)
from stringcast.stages.align.outline import sightings_from_films
from stringcast.stages.common import Progress, rms
from stringcast.stages.model.library import find_effects
from stringcast.stages.model.model import Model
from stringcast.stages.spec import StageCall

TARGET_PRECISION_S = 1e-3  # half of the 95 % interval of the clock offset

EffectRanges = dict[str, tuple[float, float, float]]  # value, low, high by name


def run(call: StageCall, trials: TrialSet) -> Alignment:
    """Align camera and arm from all trials of a run together."""
    return call.by(
        call.setup.model, trials.observations, trials.films, progress=call.progress
    )


def align(
    model: Model,
    observations: Sequence[Observation],
    films: Mapping[str, Film],
    *,
    arm_width: PositiveFloat,
    progress: Progress = lambda share: None,
) -> Alignment:
    """Align camera and arm from all trials together.

    Parameters
    ----------
    model
        The model.
    observations
        The trials. From trials without film, points at the grasp are used.
    films
        Films by trial. The arm's outline is read from them.
    arm_width
        Width of the links [m].
    progress
        Called with the completed share.

    Returns
    -------
    Alignment
        Parameters with 95 % intervals, sightings, and the likelihood's profile.

    Raises
    ------
    DataError
        If the data do not determine the alignment, with the reason.
    """
    if not observations:
        raise DataError(
            "",
            "no trial can be used",
            "See the reason given for each.",
        )
    full_model = measurement_model(model)
    filmed = {name: film for name, film in films.items() if film.arm is not None}
    trials = []
    if filmed:
        trials += sightings_from_films(
            full_model, filmed, arm_width, lambda share: progress(0.6 * share)
        )
    for observation in observations:
        if observation.trial not in filmed:
            trials.append(grasp_sightings(observation, model.arm))
    sighted = tuple(trial for trial in trials if len(trial.sightings.frame))
    problem = AlignmentProblem(full_model, sighted)
    refuse_sight(problem)
    fit = select_effects(problem)
    progress(0.8)
    refuse_fit(problem, fit)
    return build_alignment(model, problem, fit)


def build_alignment(
    model: Model, problem: AlignmentProblem, fit: AlignmentFit
) -> Alignment:
    """Build the artifact of a fit."""
    profile = likelihood_profile(problem, fit)
    lag = largest_hidden_lag(profile, fit)
    measured = measured_table(problem, fit, lag)
    names = problem.parameters(REQUIRED_EFFECTS)
    before = problem.residuals(names, np.zeros((1, len(names))))[0]
    after = fit.residual * problem.sigma
    row = {
        "sentence": alignment_sentence(measured, fit, lag),
        "rms_before": rms(before),
        "rms_after": rms(after),
        "noise": rms(problem.sigma),
        "speed": problem.max_hand_speed,
        "most_lag": lag,
        "extended": extended_settings(model, measured, fit),
    }
    return Alignment(
        measured,
        sightings_table(problem, before, after),
        profile,
        ALIGNMENT_SUMMARY.check(pd.DataFrame([row])),
    )


def extended_settings(model: Model, measured: pd.DataFrame, fit: AlignmentFit) -> str:
    """Return settings of the model with the alignment, for other experiments."""
    alignment_effects = {*REQUIRED_EFFECTS, *CANDIDATE_EFFECTS}
    effects = {*fit.effects}
    for effect in model.effects:
        names = map(effect.qualified_name, effect.parameters)
        is_named = all("." in name for name in names)
        if is_named and effect.name not in alignment_effects:
            effects.add(effect.name)
    values: dict[str, object] = {}
    for name, value in model.start_values.items():
        if name.split(".")[0] not in alignment_effects:
            values[name] = value
    found = measured[measured["found"]].set_index("name")
    values |= found[["value", "low", "high"]].to_dict("index")
    settings = {"effects": sorted(effects - {"gravity"}), "parameter_values": values}
    return mark_yaml_end(yaml.safe_dump(settings, sort_keys=False))


def sightings_table(
    problem: AlignmentProblem, before: np.ndarray, after: np.ndarray
) -> pd.DataFrame:
    """Build table SIGHTINGS with residuals (N,) [m] before and after the fit."""
    tables = []
    for trial in problem.trials:
        seen = trial.sightings
        columns = {
            "trial": trial.name,
            "t": seen.times[seen.frame],
            "link": seen.link,
            "share": seen.share,
            "sigma": seen.sigma,
            "x": seen.position[:, 0],
            "y": seen.position[:, 1],
            "along_x": seen.direction[:, 0],
            "along_y": seen.direction[:, 1],
        }
        tables.append(pd.DataFrame(columns))
    table = pd.concat(tables, ignore_index=True)
    return SIGHTINGS.check(table.assign(before=before, after=after))


def measured_table(
    problem: AlignmentProblem, fit: AlignmentFit, lag: float
) -> pd.DataFrame:
    """Build table MEASURED_PARAMETERS with 95 % intervals.

    They allow for candidate effects that were not detected, except a lag. lag: the
    largest one that would not be detected [s].
    """
    fitted = (*fit.effects, "arm_lag")
    undetected = [name for name in CANDIDATE_EFFECTS if name not in fitted]
    ranges = _intervals(add_effects(problem, fit, *undetected))
    for name, (value, low, high) in _intervals(fit).items():
        _, low_undetected, high_undetected = ranges[name]
        ranges[name] = (value, min(low, low_undetected), max(high, high_undetected))
    if "arm_lag" not in fit.effects:
        ranges[LAG] = (0.0, 0.0, lag)
    parameters = {p.name: p for p in problem.model.parameters}
    rows = []
    for name, (value, low, high) in ranges.items():
        parameter = parameters[name]
        row = {
            "name": name,
            "unit": parameter.unit,
            "meaning": parameter.meaning,
            "found": name in fit.names,
            "value": value,
            "low": max(low, parameter.low),
            "high": min(high, parameter.high),
        }
        rows.append(row)
    table = pd.DataFrame(rows)
    return MEASURED_PARAMETERS.check(
        table.sort_values(["found", "name"], ascending=[False, True])
    )


def _intervals(fit: AlignmentFit) -> EffectRanges:
    """Return value, low and high end of the 95 % interval by name."""
    low, high = fit.x - fit.half_widths, fit.x + fit.half_widths
    intervals = zip(fit.x, low, high, strict=True)
    return dict(zip(fit.names, intervals, strict=True))


def alignment_sentence(measured: pd.DataFrame, fit: AlignmentFit, lag: float) -> str:
    """Describe the measured parameters, and a lag that looks the same."""
    rows = measured.set_index("name")
    sentences, aligned = [], []
    for effect in find_effects(fit.effects):
        names = {p.name: effect.qualified_name(p) for p in effect.parameters}
        intervals = rows.loc[list(names.values())]
        if (intervals["low"] <= 0).all() and (intervals["high"] >= 0).all():
            aligned.append(effect.name)
            continue
        values = {short: fit.values[name] for short, name in names.items()}
        words = effect.describe(values)
        sentences.append(words[0].upper() + words[1:])
    if aligned:
        sentences.append(f"Within the intervals there is no {' and no '.join(aligned)}")
    half_width = float(rows.loc[OFFSET, "high"] - rows.loc[OFFSET, "low"]) / 2
    precision = f"The clock offset is known to +- {1e3 * half_width:.2f} ms (95 %)"
    if half_width >= TARGET_PRECISION_S:
        precision += f", which is more than {1e3 * TARGET_PRECISION_S:.0f} ms, the goal"
    text = f"{'. '.join(sentences)}. {precision}."
    if lag:
        text += (
            f" A lag of the arm of up to {1e3 * lag:.1f} ms would look the same in this"
            " motion if the clock offset were larger by as much: only their sum is "
            "measured."
        )
    return text
