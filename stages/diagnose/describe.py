"""The verdict in words, and as diagnosis.json (shared format, version 1)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from stringcast.stages.diagnose.fit import Fit
from stringcast.stages.diagnose.hypotheses import Hypotheses
from stringcast.stages.diagnose.prepare import Ground
from stringcast.stages.diagnose.verdict import Judgement

FORMAT = 1


def document(
    hypotheses: Hypotheses,
    ground: Ground,
    base: Fit,
    judgement: Judgement,
    causes: pd.DataFrame,
    held_out: pd.DataFrame,
    rejected: Mapping[str, str],
    unexplained: Mapping[str, Any],
    next_experiment: Mapping[str, Any] | None,
) -> dict[str, Any]:
    """diagnosis.json. base: the base model's fit from which the gain is counted."""
    used = [case.name for case in hypotheses.evidence.cases]
    listed = [*judgement.causes]
    others = sorted(set(judgement.probability) - set(listed), key=lambda name: -judgement.probability[name])
    return {
        "format": FORMAT,
        "verdict": judgement.verdict,
        "causes": [_cause(causes[causes["effect"] == name]) for name in listed],
        "alternatives": [{"effect": name, "probability": judgement.probability[name]} for name in others],
        "indistinguishable": [list(group) for group in judgement.groups],
        "base": {"parameters": base.values},
        "gain": gain(held_out)
        | {"causes_chosen_from_them": bool(len(held_out)) and set(held_out["trial"]) <= set(used)},
        "unexplained": dict(unexplained),
        "trials": {
            "used": used,
            "rejected": dict(rejected),
            "points_left_out": {"outliers": ground.outliers, "at_rest": ground.resting},
        },
        "next_experiment": next_experiment,
    }


def _cause(rows: pd.DataFrame) -> dict[str, Any]:
    first = rows.iloc[0]
    parameters = {
        row.parameter: {"value": row.value, "low": row.low, "high": row.high, "unit": row.unit}
        for row in rows.itertuples()
        if row.parameter
    }
    return {
        "effect": first["effect"],
        "probability": float(first["probability"]),
        "parameters": parameters,
        "sentence": first["sentence"],
    }


def gain(held_out: pd.DataFrame) -> dict[str, Any]:
    """Base against extended over all trials left out; NaN for what no trial tells."""

    def sides(column: str, mean: Callable[[pd.Series], float]) -> dict[str, float]:
        return {side: float(mean(held_out[f"{column}_{side}"])) for side in ("base", "extended")}

    difference = held_out["log_likelihood_difference"]
    return {
        "held_out_trials": held_out["trial"].tolist(),
        "rms_m": {**sides("rms", _rms), "noise_floor": _rms(held_out["noise_floor"])},
        "tip_rms_m": sides("tip_rms", _rms),
        "matching_rate": sides("E", pd.Series.mean),
        "log_likelihood_per_trial": {
            "difference": float(difference.mean()),
            "standard_error": float(difference.sem()),
        },
    }


def _rms(values: pd.Series) -> float:
    return float(np.sqrt(np.mean(values**2)))


def without_nan(said: Any) -> Any:
    """The same with None for every number that is not finite, of which JSON knows nothing."""
    if isinstance(said, Mapping):
        return {name: without_nan(value) for name, value in said.items()}
    if isinstance(said, list | tuple):
        return [without_nan(value) for value in said]
    return None if isinstance(said, float) and not np.isfinite(said) else said


def sentence(judgement: Judgement, causes: pd.DataFrame) -> str:
    """The verdict in one or two sentences."""
    said = causes.drop_duplicates("effect").set_index("effect")["sentence"]
    stated = {name: f"{said[name]} (probability {judgement.probability[name]:.2f})" for name in judgement.causes}
    alike = set().union(*judgement.groups)
    sure = [words for name, words in stated.items() if name not in alike]
    doubtful = [_either([stated[name] for name in group], group) for group in judgement.groups]
    named = [f"What the simulation lacks: {_and(sure)}."] if sure else []
    fixed = {
        "none": ["The simulation agrees with what was measured, within the noise: there is nothing to name."],
        "unknown": ["The simulation disagrees with what was measured, and nothing in the library explains it."],
        "insufficient": ["This data cannot answer."],
    }
    return " ".join(fixed.get(judgement.verdict, [*named, *doubtful]))


def _either(stated: Sequence[str], group: Sequence[str]) -> str:
    return f"This data cannot tell {_and(list(group))} apart: either {', or '.join(stated)}."


def _and(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}" if words else ""
