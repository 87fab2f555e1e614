"""Write diagnosis.json (format 1), the verdict in words, and extended.yaml."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from stringcast.stages.common import MM_PER_M, readable_name, rms
from stringcast.stages.diagnose.clocks.clock_offsets import Interval
from stringcast.stages.diagnose.clocks.trial_clocks import describe_trial_clocks
from stringcast.stages.diagnose.evidence.measures import unexplained_tip_rms
from stringcast.stages.diagnose.results.budget import ErrorBudget
from stringcast.stages.diagnose.rules import Criteria, misfit_remains
from stringcast.stages.diagnose.trials.prepared_data import PreparedData
from stringcast.stages.diagnose.verdict import Judgement
from stringcast.stages.inference.discrepancy_grid import count_courses, onset_time
from stringcast.stages.inference.laplace import Fit, mean_discrepancy
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.model import Model
from stringcast.stages.model.string import String

FORMAT_VERSION = 1


def trials_document(
    prepared: PreparedData, rejected: Mapping[str, str]
) -> dict[str, Any]:
    """List used and rejected trials and counts of unused points for diagnosis.json."""
    return {
        "used": [trial.name for trial in prepared.data.trials],
        "rejected": dict(rejected),
        "points_left_out": {
            "outliers": prepared.outlier_count,
            "at_rest": prepared.resting_points,
            "in_dense_frames": prepared.dense_points,
        },
    }


def effects_with_reasons(reasons: Mapping[str, str]) -> list[dict[str, str]]:
    """List effects with reasons for diagnosis.json."""
    return [{"effect": name, "reason": reason} for name, reason in reasons.items()]


def alternatives_document(judgement: Judgement) -> list[dict[str, Any]]:
    """List the probabilities of effects that are not named, of none, and of unknown."""
    verdict = judgement.verdict
    inclusion = judgement.inclusion_probability
    in_library = 1.0  # probability that what is active is in the library
    if verdict.kind == "unknown":
        in_library = 1 - verdict.misfit_probability

    others = set(inclusion) - set(verdict.causes)
    probabilities = {}
    for name in sorted(others, key=lambda name: (-inclusion[name], name)):
        probabilities[name] = in_library * inclusion[name]
    if judgement.posteriors:
        absent = [each.probabilities.get("", 0.0) for each in judgement.posteriors]
        probabilities["none"] = in_library * float(np.prod(absent))
    probabilities["unknown"] = verdict.misfit_probability
    return [{"effect": name, "probability": p} for name, p in probabilities.items()]


def budget_document(budget: ErrorBudget) -> list[dict[str, Any]]:
    """List the entries of the budget; only causes have evidence."""
    rows = []
    for entry in budget.entries:
        row = {"source": entry.source, "tip_rms_m": entry.tip_rms_m}
        if np.isfinite(entry.log_evidence):
            row["log_evidence"] = entry.log_evidence
        rows.append(row)
    return rows


def cause_document(causes: pd.DataFrame, name: str) -> dict[str, Any]:
    """Describe a cause of the table CAUSES for diagnosis.json."""
    rows = causes[causes["effect"] == name]
    parameters = {}
    for row in rows.itertuples():
        if row.parameter:
            interval = {"value": row.value, "low": row.low, "high": row.high}
            parameters[row.parameter] = {**interval, "unit": row.unit}
    first = rows.iloc[0]
    return {
        "effect": first["effect"],
        "probability": float(first["probability"]),
        "parameters": parameters,
        "sentence": first["sentence"],
    }


def gain_document(held_out: pd.DataFrame, used: Sequence[str]) -> dict[str, Any]:
    """Compare base and extended model over all left-out trials.

    Without any, numbers are NaN.

    used: names of the trials in which causes were searched.
    """
    trials = held_out["trial"].tolist()
    rms_m = {}
    tip_rms_m = {}
    rate = {}
    for side in ("base", "extended"):
        rms_m[side] = rms(held_out[f"rms_{side}"])
        tip_rms_m[side] = rms(held_out[f"tip_rms_{side}"])
        rate[side] = float(held_out[f"E_{side}"].mean())
    rms_m["noise_floor"] = rms(held_out["noise_floor"])
    difference = held_out["log_likelihood_difference"]
    return {
        "held_out_trials": trials,
        "rms_m": rms_m,
        "tip_rms_m": tip_rms_m,
        "matching_rate": rate,
        "log_likelihood_per_trial": {
            "difference": float(difference.mean()),
            "standard_error": float(difference.sem()),
        },
        "causes_chosen_from_them": bool(trials) and set(trials) <= set(used),
    }


def clocks_document(trial_clocks: Mapping[str, Interval] | None) -> dict[str, Any]:
    """List offsets of the clocks [s] for diagnosis.json, if trials differ in them."""
    if trial_clocks is None:
        return {"offsets": {}, "sentence": ""}
    offsets = {name: interval._asdict() for name, interval in trial_clocks.items()}
    return {"offsets": offsets, "sentence": describe_trial_clocks(trial_clocks)}


def replace_non_finite(document: Any) -> Any:
    """Replace non-finite numbers by None, because JSON has none."""
    if isinstance(document, Mapping):
        return {name: replace_non_finite(value) for name, value in document.items()}
    if isinstance(document, list | tuple):
        return [replace_non_finite(value) for value in document]
    is_number = isinstance(document, float)
    return None if is_number and not np.isfinite(document) else document


def unexplained_document(
    data: TrialData,
    fit: Fit,
    judgement: Judgement,
    budget: ErrorBudget,
    criteria: Criteria,
) -> dict[str, Any]:
    """Describe the remaining misfit for diagnosis.json."""
    value, low, high = budget.unexplained_m
    misfit_m = rms(unexplained_tip_rms(data, fit))
    base_misfit_m = rms(unexplained_tip_rms(data, judgement.base_fit))
    fraction = 0.0
    if judgement.verdict.kind != "none" and misfit_m > 0:
        fraction = (misfit_m / max(base_misfit_m, misfit_m)) ** 2
    where = course = ""
    sentences = [judgement.verdict.remark]
    if misfit_remains(judgement.verdict.misfit_probability):
        where = _largest_misfit_sentence(data, fit)
        course = _course_sentence(fit.grid_points)
        # The value of the budget, unless numerical error may explain all of it
        left_mm = MM_PER_M * (value if low > 0 else misfit_m)
        misfit = f"A misfit of {left_mm:.1f} mm is left at the tip"
        if judgement.verdict.kind == "partial":
            before_mm = MM_PER_M * base_misfit_m
            misfit = (
                f"{left_mm:.1f} of {before_mm:.1f} mm remain unexplained at the tip"
            )
        sentences.append(f"{misfit}; {where}.")
    return {
        "fraction": fraction,
        "tip_rms_m": {"value": value, "low": low, "high": high},
        "tolerance_m": criteria.tip_tolerance_m,
        "where": where,
        "course": course,
        "sentence": " ".join(filter(None, sentences)),
    }


def _course_sentence(grid_points: np.ndarray) -> str:
    """State how the discrepancies of trials (K,) change over time, if there are any."""
    grows, *begin_later, constant = count_courses(grid_points).tolist()
    counts = {
        "grows over the trial": grows,
        "begins during the trial": sum(begin_later),
        "has the same size at all times": constant,
    }
    stated = [f"{course} in {n}" for course, n in counts.items() if n > 0]
    if not stated:
        return ""
    stated[0] += f" of {len(grid_points)} trials"
    return f"The unexplained misfit {_join_with_and(stated)}."


def _largest_misfit_sentence(data: TrialData, fit: Fit) -> str:
    """State the trial with the largest misfit, and when and where it is largest."""
    tip_rms = unexplained_tip_rms(data, fit)
    k = int(np.argmax(tip_rms))
    trial = data.trials[k]
    share = tip_rms[k] ** 2 / np.sum(tip_rms**2)
    discrepancy = mean_discrepancy(data, fit)[k].reshape(-1, 2)
    misfit_m = np.linalg.norm(discrepancy, axis=1) * trial.sigma
    worst = int(np.argmax(misfit_m))
    onset_s = onset_time(trial.times, fit.grid_points[k])
    begins = f"from {onset_s:.2f} s on, " if onset_s > trial.times[0] else ""
    return (
        f"most of it in trial {trial.name} ({MM_PER_M * tip_rms[k]:.1f} mm there, "
        f"{100 * share:.0f} % of the whole), {begins}largest at "
        f"{trial.times[trial.frame[worst]]:.2f} s, "
        f"{trial.s[worst]:.2f} m along the string"
    )


def verdict_sentences(
    judgement: Judgement, causes: pd.DataFrame, unexplained: str
) -> list[str]:
    """State verdict and remaining misfit; the latter first if causes explain a part.

    unexplained: sentence of `unexplained_document`.
    """
    stated = _verdict_sentence(judgement, causes)
    if judgement.verdict.kind == "partial":
        return [unexplained, stated]
    return [stated, unexplained]


def _verdict_sentence(judgement: Judgement, causes: pd.DataFrame) -> str:
    """State the verdict in one or two sentences."""
    verdict = judgement.verdict
    if verdict.kind == "none":
        return (
            "The simulation agrees with the measured trials within noise and tolerance."
        )
    if verdict.kind == "unknown":
        return (
            "The simulation disagrees with the measured trials, "
            "and no effect of the library explains it."
        )
    if verdict.kind == "insufficient":
        return "" if judgement.interrupted else "These trials cannot answer."
    return " ".join(_cause_sentences(judgement, causes))


def _cause_sentences(judgement: Judgement, causes: pd.DataFrame) -> list[str]:
    """State the named causes, with look-alikes in one sentence."""
    verdict = judgement.verdict
    inclusion = judgement.inclusion_probability
    by_effect = causes.drop_duplicates("effect").set_index("effect")["sentence"]
    stated = {}
    for name in verdict.causes:
        stated[name] = f"{by_effect[name]} (probability {inclusion[name]:.2f})"
    lookalikes = set().union(*verdict.lookalike_groups)
    certain = [stated[name] for name in verdict.causes if name not in lookalikes]
    sentences = []
    if certain:
        label = "Causes" if len(certain) > 1 else "Cause"
        share = " of a part" if verdict.kind == "partial" else ""
        sentences.append(f"{label}{share} of the misfit: {_join_with_and(certain)}.")
    for group in verdict.lookalike_groups:
        either = ", or ".join(stated[name] for name in group)
        names = _join_with_and([readable_name(name) for name in group])
        sentences.append(f"These trials cannot distinguish {names}: either {either}.")
    return sentences


def _join_with_and(words: Sequence[str]) -> str:
    if len(words) == 1:
        return words[0]
    return f"{', '.join(words[:-1])} and {words[-1]}"


def extended_model_settings(
    model: Model,
    fit: Fit,
    intervals: Mapping[str, Sequence[float]],
) -> dict[str, object]:
    """Convert a fit to model settings for other stages.

    Parameters
    ----------
    intervals : dict
        Intervals of parameters for later stages, by qualified name. Those that were
        measured beforehand are added.
    """
    string = fit.hypothesis.model.string
    values = fit.values
    kind = type(string.integrator)
    target = f"{kind.__module__}.{kind.__qualname__}".removeprefix("stringcast.")
    string_settings: dict[str, object] = {
        "length": float(f"{string.length:.8g}"),
        "points": string.points,
        "tip_cell": string.tip_cell,
        "grasp_cell": string.grasp_cell,
        "largest_step": string.largest_step,
        "ranges": widened_ranges(model.string, string),
        "integrator": {"_target_": target},
    }
    known: dict[str, object] = {}
    for name, value in values.items():
        known[name] = float(f"{value:.8g}")
    for name, (low, high) in {**intervals, **model.measured_ranges}.items():
        value = float(np.clip(values[name], low, high))
        known[name] = value
        if low < high:  # an interval at an end of its range may have zero width
            known[name] = {"value": value, "low": low, "high": high}
    names = {*fit.hypothesis.cause_names}
    for effect in model.effects:
        if not effect.parameters or "." in effect.qualified_name(effect.parameters[0]):
            names.add(effect.name)
    effects = sorted(names - {"gravity"})
    return {"effects": effects, "string": string_settings, "parameter_values": known}


def widened_ranges(configured: String, string: String) -> dict[str, dict[str, float]]:
    """Collect the ranges that the data required to be wider than configured."""
    before = {p.name: (p.low, p.high) for p in configured.parameters}
    widened = {}
    for name, p in string.ranges.items():
        if (p.low, p.high) != before[name]:
            widened[name] = {"low": p.low, "high": p.high}
    return widened
