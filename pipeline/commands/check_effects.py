"""`check --effects`: from which size on each effect would be found in trials. Apart, as it takes seconds to load."""

from __future__ import annotations

from collections.abc import Sequence
from math import isnan
from pathlib import Path
from typing import Any

import numpy as np
from omegaconf import OmegaConf

from stringcast.data.schema import DataError
from stringcast.pipeline.console import bars
from stringcast.pipeline.experiment import prepare
from stringcast.pipeline.inherited import with_inherited_settings
from stringcast.pipeline.modes.stored import held_out, usable
from stringcast.pipeline.settings import build, composed, names_given
from stringcast.pipeline.terminal import Terminal
from stringcast.stages.diagnose.identifiability import Foreseen, foreseen
from stringcast.stages.diagnose.prepared import prepared
from stringcast.stages.diagnose.prepared import usable as can_begin
from stringcast.stages.diagnose.proposals import candidates
from stringcast.stages.diagnose.single_effects import Criteria
from stringcast.stages.estimate.trim import trimmed_at_contact
from stringcast.stages.model.library import library


def effects(folder: Path, overrides: Sequence[str]) -> list[dict[str, Any]]:
    """What a diagnosis of a folder's trials with these settings could tell of each effect, JSON-able, with a bar on the
    terminal meanwhile. Raises DataError or UserError where there could be none."""
    config = OmegaConf.create({**composed(["+experiment=diagnose", *overrides]), "trials": str(folder)})
    here = prepare(with_inherited_settings(config, names_given(overrides)), lambda block: f"conf/{block}")
    data, asked = usable(here), here.config["diagnose"]
    asked_of = (trial for name, trial in data.trials.items() if name not in held_out(data))
    seen, _ = can_begin(here.model, [trimmed_at_contact(trial, here.obstacles) for trial in asked_of])
    if len(seen) < 2:
        raise DataError(f"{folder}: causes are sought in two trials or more. Record more.")
    criteria = build(Criteria, asked["criteria"], "diagnose.criteria", "conf/diagnose")
    with bars(Terminal(stderr=True)) as bar, bar("effects") as progress:
        rng = np.random.default_rng(here.seed)
        ready = prepared(
            here.model, seen, criteria.tolerance, rng, asked["starts"], lambda share: progress(0.7 * share)
        )
        sought = candidates(ready.base.hypothesis.model, library(), ready.data.trials, asked["without"])
        told = foreseen(ready, sought, criteria, here.seed, lambda share: progress(0.7 + 0.3 * share))
    return [row(each) for each in told]


def row(told: Foreseen) -> dict[str, Any]:
    """A row as JSON has it; None for what no value of the range does."""
    parameter = told.parameter
    return {
        "effect": told.effect.name,
        "parameter": parameter.name,
        "meaning": parameter.meaning,
        "unit": parameter.unit,
        "absent": told.absent,
        "found_from": None if isnan(told.found) else told.found,
        "tip_m": None if isnan(told.tip) else told.tip,
        "most_tip_m": told.most,
        "imitated": told.imitated,
        "alike": list(told.alike),
    }
