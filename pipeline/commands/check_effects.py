"""`check --effects`: the smallest detectable size of each effect.

It is a separate module, as it takes seconds to import.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import isnan
from typing import Any

import numpy as np

from stringcast.data.artifacts import Observation
from stringcast.data.schema import DataError
from stringcast.pipeline.cli.console import progress_bar
from stringcast.pipeline.modes.stored_trials import read_usable_trials
from stringcast.pipeline.run.experiment import Experiment, prepare_experiment
from stringcast.pipeline.settings.typed_settings import build_dataclass
from stringcast.stages.diagnose.evidence.identifiability import (
    DetectionLimit,
    detection_limits,
)
from stringcast.stages.diagnose.rules import Criteria
from stringcast.stages.diagnose.search.proposals import effects_left_out
from stringcast.stages.diagnose.trials.preparation import prepare_data, usable_trials
from stringcast.stages.estimate.trim import trim_at_contact
from stringcast.stages.model.effect import is_position_dependent
from stringcast.stages.model.library import effects_by_name


def detectable_effects(
    settings: Mapping[str, Any],
) -> tuple[list[dict[str, Any]], dict[str, str]]:
    """Return the detection limits of a diagnosis of stored trials, with a bar.

    Returns JSON-able rows, one for each size parameter of an effect, and the reasons
    why other effects were not tried, by name. Raises DataError or UserError if these
    trials cannot be diagnosed.
    """
    experiment = prepare_experiment(settings, lambda block: f"conf/{block}")
    options = experiment.config["diagnose"]
    trials = search_trials(experiment)
    criteria = build_dataclass(
        Criteria, options["criteria"], "diagnose.criteria", "conf/diagnose"
    )
    with progress_bar("effects") as progress:
        prepared = prepare_data(
            experiment.model,
            trials,
            criteria.tip_tolerance_m,
            np.random.default_rng(experiment.seed),
            options["starts"],
            lambda share: progress(0.7 * share),
        )
        library = effects_by_name()
        not_tried = effects_left_out(
            prepared.base_fit.hypothesis.model,
            library,
            prepared.data.trials,
            options["excluded_effects"],
        )
        candidates = [library[name] for name in library if name not in not_tried]
        limits = detection_limits(
            prepared,
            candidates,
            criteria,
            experiment.seed,
            lambda share: progress(0.7 + 0.3 * share),
        )
    for effect in candidates:
        if is_position_dependent(effect):
            not_tried[effect.name] = "no smallest size: it depends on the place"
    rows = [detection_row(limit) for limit in limits]
    return rows, dict(sorted(not_tried.items()))


def search_trials(experiment: Experiment) -> list[Observation]:
    """Return the trials in which a diagnosis would search causes.

    Raises DataError for fewer than two.
    """
    data = read_usable_trials(experiment)
    given = []
    for name, trial in data.trials.items():
        if name not in data.held_out:
            given.append(trim_at_contact(trial, experiment.obstacles))
    trials, _ = usable_trials(experiment.model, given)
    if len(trials) < 2:
        raise DataError(
            experiment.config["trials"],
            "causes are sought in two trials or more",
            "Record more.",
        )
    return trials


def detection_row(limit: DetectionLimit) -> dict[str, Any]:
    """Return a JSON-able row, with None if no value in the range is detectable."""
    parameter = limit.parameter
    return {
        "effect": limit.effect.name,
        "parameter": parameter.name,
        "meaning": parameter.meaning,
        "unit": parameter.unit,
        "absent": limit.absent_value,
        "found_from": none_if_nan(limit.detectable_value),
        "tip_m": none_if_nan(limit.detectable_tip_shift_m),
        "most_tip_m": limit.max_tip_shift_m,
        "imitated": limit.imitated_fraction,
        "alike": list(limit.lookalikes),
    }


def none_if_nan(value: float) -> float | None:
    """Return a number, or None for NaN, which JSON lacks."""
    return None if isnan(value) else value
