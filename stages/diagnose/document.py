"""The verdict in words, as diagnosis.json (shared format, version 1), and the extended
model as settings.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from stringcast.stages.diagnose.budget import ErrorBudget
from stringcast.stages.diagnose.forward_selection import Criteria, unexplained_tip_rms
from stringcast.stages.diagnose.prepared_data import PreparedData
from stringcast.stages.diagnose.verdict import Judgement
from stringcast.stages.inference.laplace import Fit, mean_discrepancy
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.model import Model
from stringcast.stages.model.string import String

FORMAT_VERSION = 1
MM_PER_M = 1e3


def diagnosis_document(
    prepared: PreparedData,
    base: Fit,
    judgement: Judgement,
    budget: ErrorBudget,
    causes: pd.DataFrame,
    held_out: pd.DataFrame,
    rejected: Mapping[str, str],
    left: Mapping[str, Any],
    next_experiment: Mapping[str, Any] | None,
    certainty: Mapping[str, Mapping[str, Any]],
) -> dict[str, Any]:
    """diagnosis.json. certainty: intervals and correlations of parameters, of the
    `base` and the `extended` model.
    """
    used, listed = [trial.name for trial in prepared.data.trials], [*judgement.causes]
    others = sorted(
        set(judgement.inclusion_probability) - set(listed),
        key=lambda name: (-judgement.inclusion_probability[name], name),
    )
    # that what is at work is in the library
    known = 1 - judgement.misfit_probability if judgement.verdict == "unknown" else 1.0
    # that no effect is at work
    none = known * float(
        np.prod([slot.probabilities.get("", 0.0) for slot in judgement.posteriors])
    )
    rest = ({"none": none} if judgement.posteriors else {}) | {
        "unknown": judgement.misfit_probability
    }
    alternatives = [
        {"effect": name, "probability": known * judgement.inclusion_probability[name]}
        for name in others
    ]
    return {
        "format": FORMAT_VERSION,
        "verdict": judgement.verdict,
        "interrupted": judgement.interrupted,
        "causes": [cause_document(causes[causes["effect"] == name]) for name in listed],
        "alternatives": alternatives
        + [{"effect": n, "probability": p} for n, p in rest.items() if n not in listed],
        "indistinguishable": [list(group) for group in judgement.lookalike_groups],
        "base": {"parameters": base.values, **certainty["base"]},
        "extended": certainty["extended"],
        "gain": gain_document(held_out)
        | {
            "causes_chosen_from_them": bool(len(held_out))
            and set(held_out["trial"]) <= set(used)
        },
        "unexplained": dict(left),
        "budget": _budget_rows(budget),
        "trials": {
            "used": used,
            "rejected": dict(rejected),
            "points_left_out": {
                "outliers": prepared.outlier_count,
                "at_rest": prepared.resting_points,
            },
        },
        "next_experiment": next_experiment,
    }


def _budget_rows(budget: ErrorBudget) -> list[dict[str, Any]]:
    """The budget; only causes have evidence."""
    rows = []
    for entry in budget.entries:
        row = {"source": entry.source, "tip_rms_m": entry.tip_rms_m}
        rows.append(
            row
            | (
                {"log_evidence": entry.log_evidence}
                if np.isfinite(entry.log_evidence)
                else {}
            )
        )
    return rows


def cause_document(rows: pd.DataFrame) -> dict[str, Any]:
    """A cause as it stands in diagnosis.json. rows: of table CAUSES."""
    first = rows.iloc[0]
    parameters = {
        row.parameter: {
            "value": row.value,
            "low": row.low,
            "high": row.high,
            "unit": row.unit,
        }
        for row in rows.itertuples()
        if row.parameter
    }
    found = {
        "effect": first["effect"],
        "probability": float(first["probability"]),
        "parameters": parameters,
    }
    return found | {"sentence": first["sentence"]}


def gain_document(held_out: pd.DataFrame) -> dict[str, Any]:
    """Base against extended over all trials left out; NaN for what no trial tells."""

    def sides(column: str, mean: Callable[[pd.Series], float]) -> dict[str, float]:
        return {
            side: float(mean(held_out[f"{column}_{side}"]))
            for side in ("base", "extended")
        }

    difference = held_out["log_likelihood_difference"]
    return {
        "held_out_trials": held_out["trial"].tolist(),
        "rms_m": {
            **sides("rms", _rms_over_trials),
            "noise_floor": _rms_over_trials(held_out["noise_floor"]),
        },
        "tip_rms_m": sides("tip_rms", _rms_over_trials),
        "matching_rate": sides("E", pd.Series.mean),
        "log_likelihood_per_trial": {
            "difference": float(difference.mean()),
            "standard_error": float(difference.sem()),
        },
    }


def _rms_over_trials(values: pd.Series) -> float:
    return float(np.sqrt(np.mean(values**2)))


def replace_non_finite(said: Any) -> Any:
    """The same with None for every number that is not finite, of which JSON knows
    nothing.
    """
    if isinstance(said, Mapping):
        return {name: replace_non_finite(value) for name, value in said.items()}
    if isinstance(said, list | tuple):
        return [replace_non_finite(value) for value in said]
    return None if isinstance(said, float) and not np.isfinite(said) else said


def unexplained_document(
    data: TrialData,
    fit: Fit,
    base: Fit,
    judgement: Judgement,
    budget: ErrorBudget,
    criteria: Criteria,
) -> dict[str, Any]:
    """What diagnosis.json says of what is left."""
    value, low, high = budget.unexplained_m
    square, before = (
        unexplained_tip_rms(data, fit) ** 2,
        unexplained_tip_rms(data, base) ** 2,
    )
    fraction = float(
        np.clip(square.sum() / max(before.sum(), np.finfo(float).tiny), 0, 1)
    )
    rms = {"value": value, "low": low, "high": high}
    where = (
        _largest_misfit_sentence(data, fit)
        if judgement.misfit_probability > 0.5
        else ""
    )
    rest = (
        f"What is left is {MM_PER_M * value:.1f} mm at the tip; {where}."
        if where
        else ""
    )
    said = " ".join(filter(None, (judgement.remark, rest)))
    found = {
        "fraction": fraction if judgement.verdict != "none" else 0.0,
        "tip_rms_m": rms,
    }
    return found | {"tolerance_m": criteria.tolerance, "where": where, "sentence": said}


def _largest_misfit_sentence(data: TrialData, fit: Fit) -> str:
    """In which trial, when and where along the string most is left."""
    sizes = unexplained_tip_rms(data, fit)
    k = int(np.argmax(sizes))
    trial = data.trials[k]
    off = (
        np.linalg.norm(mean_discrepancy(data, fit)[k].reshape(-1, 2), axis=1)
        * trial.sigma
    )
    worst, share = int(np.argmax(off)), sizes[k] ** 2 / np.sum(sizes**2)
    return (
        f"most in trial {trial.name} ({100 * share:.0f} % of it), {MM_PER_M * off[worst]:.1f} mm at "
        f"{trial.times[trial.frame[worst]]:.2f} s, {trial.s[worst]:.2f} m along the string"
    )


def verdict_sentence(judgement: Judgement, causes: pd.DataFrame) -> str:
    """The verdict in one or two sentences."""
    fixed = {
        "none": [
            "The simulation agrees with what was measured, within noise and tolerance: there is nothing to name."
        ],
        "unknown": [
            "The simulation disagrees with what was measured, and nothing in the library explains it."
        ],
        "insufficient": [] if judgement.interrupted else ["This data cannot answer."],
    }
    stated = cause_sentences(
        judgement.causes,
        judgement.lookalike_groups,
        judgement.inclusion_probability,
        causes,
    )
    return " ".join(fixed.get(judgement.verdict, stated))


def cause_sentences(
    names: Sequence[str],
    groups: Sequence[Sequence[str]],
    probability: Mapping[str, float],
    causes: pd.DataFrame,
) -> list[str]:
    """Sentences that state the causes of these names, look-alikes together. causes:
    table CAUSES.
    """
    said = causes.drop_duplicates("effect").set_index("effect")["sentence"]
    stated = {
        name: f"{said[name]} (probability {probability[name]:.2f})" for name in names
    }
    alike = {name for group in groups for name in group}
    sure = [words for name, words in stated.items() if name not in alike]
    said = [f"What the simulation lacks: {_join_with_and(sure)}."] if sure else []
    for group in groups:
        either = ", or ".join(stated[name] for name in group)
        said.append(
            f"This data cannot tell {_join_with_and(list(group))} apart: either {either}."
        )
    return said


def _join_with_and(words: Sequence[str]) -> str:
    return (
        words[0]
        if len(words) == 1
        else f"{', '.join(words[:-1])} and {words[-1]}"
        if words
        else ""
    )


def extended_model_settings(
    model: Model, fit: Fit, intervals: Mapping[str, Sequence[float]]
) -> dict[str, object]:
    """A fit as settings that other stages take: what is at work, and what is known of
    it.

    intervals: of what stages that come after must not leave, by qualified name; or of
    what was measured beforehand.
    """
    string, values = fit.hypothesis.model.string, fit.values
    kind = type(string.integrator)
    integrator = {
        "_target_": f"{kind.__module__}.{kind.__qualname__}".removeprefix("stringcast.")
    }
    told: dict[str, object] = {
        "length": float(f"{string.length:.8g}"),
        "points": string.points,
    }
    told |= {"tip_cell": string.tip_cell, "grasp_cell": string.grasp_cell}
    told |= {
        "largest_step": string.largest_step,
        "ranges": widened_ranges(model.string, string),
        "integrator": integrator,
    }
    known: dict[str, object] = {
        name: float(f"{value:.8g}") for name, value in values.items()
    }
    for name, (low, high) in {**intervals, **model.measured_ranges}.items():
        known[name] = {
            "value": float(np.clip(values[name], low, high)),
            "low": low,
            "high": high,
        }
    at_work = [
        e.name
        for e in model.effects
        if not e.parameters or "." in e.qualified_name(e.parameters[0])
    ]
    effects = sorted({*at_work, *fit.hypothesis.cause_names} - {"gravity"})
    return {"effects": effects, "string": told, "known": known}


def widened_ranges(configured: String, string: String) -> dict[str, dict[str, float]]:
    """Ranges that the data asked to be wider than they are configured."""
    known = {p.name: p for p in configured.parameters}
    changed = {
        n: p
        for n, p in string.ranges.items()
        if (p.low, p.high) != (known[n].low, known[n].high)
    }
    return {name: {"low": p.low, "high": p.high} for name, p in changed.items()}
