"""Trials whose motion is too sensitive to be simulated to the tolerance."""

from __future__ import annotations

from dataclasses import replace

from stringcast.stages.diagnose.discretisation import correct_data_at
from stringcast.stages.diagnose.measures import refit
from stringcast.stages.diagnose.prepared_data import PreparedData
from stringcast.stages.diagnose.rules import MIN_RESOLVED_TRIALS


def unresolvable_trials(prepared: PreparedData, tolerance_m: float) -> list[str]:
    """Name trials whose discretisation error is uncertain by the tolerance or more.

    Returns an empty list where too few trials would remain.
    """
    names = []
    for k, trial in enumerate(prepared.trials):
        if not prepared.discretisation_uncertainty_m[k] < tolerance_m:
            names.append(trial.name)
    remaining = len(prepared.trials) - len(names)
    return names if remaining >= MIN_RESOLVED_TRIALS else []


def exclude_chaotic_trials(prepared: PreparedData, tolerance_m: float) -> PreparedData:
    """Exclude unresolvable trials and refit the base model: they say nothing of causes.

    Trials in `keep_if_chaotic` stay.
    """
    unresolvable = unresolvable_trials(prepared, tolerance_m)
    names = [name for name in unresolvable if name not in prepared.keep_if_chaotic]
    if not names:
        return prepared
    kept = [k for k, trial in enumerate(prepared.trials) if trial.name not in names]
    base = replace(
        prepared.base_fit, scale_indices=prepared.base_fit.scale_indices[kept]
    )
    remaining = replace(
        prepared,
        trials_with_outliers=tuple(prepared.trials_with_outliers[k] for k in kept),
        trials=tuple(prepared.trials[k] for k in kept),
        data=prepared.data.subset(kept),
        chaotic_trials=(*prepared.chaotic_trials, *names),
    )
    corrected = correct_data_at(remaining, base)
    base_fit = refit(corrected.data, base, base.hypothesis)
    return replace(corrected, base_fit=base_fit)
