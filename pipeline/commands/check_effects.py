"""`check --effects`: from which size on each effect would be found in trials. Apart, as
it takes seconds to load.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isnan
from pathlib import Path
from typing import Any

import numpy as np
from omegaconf import OmegaConf

from stringcast.data.schema import DataError
from stringcast.pipeline.cli.console import progress_bars
from stringcast.pipeline.cli.terminal import Terminal
from stringcast.pipeline.modes.stored_trials import held_out_trials, read_usable_trials
from stringcast.pipeline.run.experiment import prepare_experiment
from stringcast.pipeline.settings.composition import compose_settings, given_names
from stringcast.pipeline.settings.settings_from_runs import inherit_settings
from stringcast.pipeline.settings.typed_settings import build_dataclass
from stringcast.stages.diagnose.identifiability import DetectionLimit, detection_limits
from stringcast.stages.diagnose.preparation import prepare_data, usable_trials
from stringcast.stages.diagnose.proposals import candidate_effects
from stringcast.stages.diagnose.rules import Criteria
from stringcast.stages.estimate.trim import trim_at_contact
from stringcast.stages.model.library import effects_by_name


def detectable_effects(folder: Path, overrides: Sequence[str]) -> list[dict[str, Any]]:
    """What a diagnosis of a folder's trials with these settings could tell of each
    effect, JSON-able, with a bar on the terminal meanwhile. Raises DataError or
    UserError where there could be none.
    """
    config = OmegaConf.create(
        {
            **compose_settings(["+experiment=diagnose", *overrides]),
            "trials": str(folder),
        }
    )
    here = prepare_experiment(
        inherit_settings(config, given_names(overrides)), lambda block: f"conf/{block}"
    )
    data, asked = read_usable_trials(here), here.config["diagnose"]
    asked_of = (
        trial
        for name, trial in data.trials.items()
        if name not in held_out_trials(data)
    )
    seen, _ = usable_trials(
        here.model, [trim_at_contact(trial, here.obstacles) for trial in asked_of]
    )
    if len(seen) < 2:
        raise DataError(
            f"{folder}: causes are sought in two trials or more. Record more."
        )
    criteria = build_dataclass(
        Criteria, asked["criteria"], "diagnose.criteria", "conf/diagnose"
    )
    with progress_bars(Terminal(stderr=True)) as bar, bar("effects") as progress:
        rng = np.random.default_rng(here.seed)
        ready = prepare_data(
            here.model,
            seen,
            criteria.tip_tolerance_m,
            rng,
            asked["starts"],
            lambda share: progress(0.7 * share),
        )
        sought = candidate_effects(
            ready.base_fit.hypothesis.model,
            effects_by_name(),
            ready.data.trials,
            asked["excluded_effects"],
        )
        told = detection_limits(
            ready,
            sought,
            criteria,
            here.seed,
            lambda share: progress(0.7 + 0.3 * share),
        )
    return [detection_row(each) for each in told]


def detection_row(told: DetectionLimit) -> dict[str, Any]:
    """A row as JSON has it; None for what no value of the range does."""
    parameter = told.parameter
    return {
        "effect": told.effect.name,
        "parameter": parameter.name,
        "meaning": parameter.meaning,
        "unit": parameter.unit,
        "absent": told.absent_value,
        "found_from": None if isnan(told.detectable_value) else told.detectable_value,
        "tip_m": None
        if isnan(told.detectable_tip_shift_m)
        else told.detectable_tip_shift_m,
        "most_tip_m": told.max_tip_shift_m,
        "imitated": told.imitated_fraction,
        "alike": list(told.lookalikes),
    }
