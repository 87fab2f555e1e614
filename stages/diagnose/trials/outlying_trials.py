"""Detection of a trial that the others do not predict, though they predict each other.

Something may have happened only there: its string touched something, its marker was
lost, or it belongs to another motion. No other trial can confirm such a cause, and its
misfit would hide causes common to the others.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stringcast.data.artifacts import Observation
from stringcast.stages.common import MM_PER_M
from stringcast.stages.diagnose.evidence.predictions import predict_trials, tip_errors
from stringcast.stages.diagnose.rules import Criteria
from stringcast.stages.diagnose.search.selection_state import SelectionState
from stringcast.stages.diagnose.trials.preparation import prepare_further_trials

MIN_TRIALS = 4  # three that agree against one
OUTLYING = "the others predict its tip"  # begins the reason
MAX_ERROR_RATIO = 10.0  # over the median of the others; some 3 by different motions


def find_outlying_trial(state: SelectionState, criteria: Criteria) -> dict[str, str]:
    """Find the trial that the others predict far worse than each other.

    Each trial is predicted by a fit of the present causes to the others.

    Returns
    -------
    dict
        The trial's name with the reason; empty if there is none.
    """
    data = state.prepared.data
    if len(data.trials) < MIN_TRIALS:
        return {}
    errors_m = tip_errors(data, state.predictions)
    worst = int(np.argmax(errors_m))
    others_m = float(np.median(np.delete(errors_m, worst)))
    if errors_m[worst] <= _largest_error(others_m, criteria):
        return {}
    reason = (
        f"{OUTLYING} to {MM_PER_M * errors_m[worst]:.0f} mm, "
        f"and each other to {MM_PER_M * others_m:.1f} mm"
    )
    return {data.trials[worst].name: reason}


def find_predicted_trials(
    state: SelectionState, excluded: Sequence[Observation], criteria: Criteria
) -> list[str]:
    """Find excluded trials that are predicted by the causes found without them.

    They seemed to be outlying because causes or string parameters were wrong.

    Returns
    -------
    list of str
        Their names.
    """
    if not excluded:
        return []
    data = state.prepared.data
    others_m = float(np.median(tip_errors(data, state.predictions)))
    names = []
    for observation in excluded:
        further, _ = prepare_further_trials(state.prepared, [observation], state.fit)
        predictions = predict_trials(further, state.fit)
        (error_m,) = tip_errors(further, predictions)
        if error_m <= _largest_error(others_m, criteria):
            names.append(observation.trial)
    return names


def _largest_error(others_m: float, criteria: Criteria) -> float:
    """Return the largest error of a trial [m] that is not outlying."""
    return max(criteria.tip_tolerance_m, MAX_ERROR_RATIO * others_m)
