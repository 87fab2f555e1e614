"""The verdict in words, and as diagnosis.json (shared format, version 1)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from stringcast.stages.diagnose.fit import Fit
from stringcast.stages.diagnose.hypotheses import Hypotheses
from stringcast.stages.diagnose.prepare import Ground
from stringcast.stages.diagnose.single_effects.document import FORMAT, cause_entry, causes_in_words, gain
from stringcast.stages.diagnose.verdict import Judgement


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
    others = sorted(set(judgement.probability) - set(listed), key=lambda name: (-judgement.probability[name], name))
    return {
        "format": FORMAT,
        "verdict": judgement.verdict,
        "causes": [cause_entry(causes[causes["effect"] == name]) for name in listed],
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


def sentence(judgement: Judgement, causes: pd.DataFrame) -> str:
    """The verdict in one or two sentences."""
    fixed = {
        "none": ["The simulation agrees with what was measured, within the noise: there is nothing to name."],
        "unknown": ["The simulation disagrees with what was measured, and nothing in the library explains it."],
        "insufficient": ["This data cannot answer."],
    }
    stated = causes_in_words(judgement.causes, judgement.groups, judgement.probability, causes)
    return " ".join(fixed.get(judgement.verdict, stated))
