"""The gain of the extended model on trials that were not fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from stringcast.data.artifacts import Observation
from stringcast.data.diagnoses import HELD_OUT
from stringcast.stages.diagnose.evidence.measures import (
    mean_explained_fraction,
    unexplained_tip_rms,
)
from stringcast.stages.diagnose.evidence.predictions import (
    held_out_table,
    improves_predictions,
    predict_left_out_trials,
    predict_trials,
)
from stringcast.stages.diagnose.rules import Criteria, VerdictNumbers
from stringcast.stages.diagnose.search.selection_state import SelectionState
from stringcast.stages.diagnose.trials.preparation import prepare_further_trials
from stringcast.stages.diagnose.trials.trials_by_use import TrialsByUse
from stringcast.stages.estimate.matching import Matching
from stringcast.stages.inference.laplace import Fit, fit_hypothesis
from stringcast.stages.inference.trial_data import TrialData


def held_out_trials_misfit(
    state: SelectionState,
    held_out: Sequence[Observation],
    criteria: Criteria,
) -> bool:
    """Return whether held-out trials misfit by more than the tolerance.

    The model is fitted to them, too, so that undetermined parameters are not mistaken
    for a cause.
    """
    if not held_out:
        return False
    searched = state.prepared.data
    fit = state.fit
    further, _ = prepare_further_trials(state.prepared, held_out, fit)
    random_effects = {}
    for name, shapes in searched.random_effects.items():
        if name in further.random_effects:
            random_effects[name] = shapes + further.random_effects[name]
    together = TrialData(searched.trials + further.trials, random_effects)
    no_discrepancy = np.zeros(len(further.trials), dtype=int)  # initially
    grid_points = np.concatenate([fit.grid_points, no_discrepancy])
    refit = fit_hypothesis(together, fit.hypothesis, fit.chi[None], grid_points)
    misfit_m = unexplained_tip_rms(together, refit)[len(searched.trials) :]
    return bool(misfit_m.max() > criteria.tip_tolerance_m)


@dataclass(frozen=True)
class HeldOutGain:
    """The gain on trials that were not fitted.

    Attributes
    ----------
    table : pandas.DataFrame
        HELD_OUT, empty if nothing could be left out.
    is_closer : bool
        Whether the extended model predicts these trials better than the base model.
    """

    table: pd.DataFrame
    is_closer: bool

    def added_to(self, numbers: VerdictNumbers, criteria: Criteria) -> VerdictNumbers:
        """Add the gain to the numbers of a verdict."""
        fraction = numbers.heldout_explained_fraction
        if len(self.table):
            fraction = mean_explained_fraction(
                self.table["tip_rms_base"].to_numpy(),
                self.table["tip_rms_extended"].to_numpy(),
                criteria.tip_tolerance_m,
            )
        return replace(
            numbers,
            heldout_is_closer=self.is_closer,
            heldout_explained_fraction=fraction,
        )


def measure_gain(
    trials: TrialsByUse,
    matching: Matching,
    state: SelectionState,
    base_fit: Fit,
) -> HeldOutGain:
    """Predict held-out trials, or without any, each trial by the fit to the others."""
    if len(trials.observations) == 1:
        return HeldOutGain(HELD_OUT.empty(), False)
    observations = trials.held_out or trials.searched_trials
    fit = state.fit
    data = state.prepared.data
    if trials.held_out:
        predict = predict_trials
        data, _ = prepare_further_trials(state.prepared, observations, fit)
        extended = predict_trials(data, fit)
    else:
        predict = predict_left_out_trials
        extended = state.predictions
    base = extended
    if base_fit is not fit:
        base = predict(data, base_fit)
    table = held_out_table(data, base, extended, fit, observations, matching)
    return HeldOutGain(table, improves_predictions(base, extended))
