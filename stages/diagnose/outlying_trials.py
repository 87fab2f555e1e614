"""A trial that the others do not predict, though they predict each other.

Something happened in it alone: its string touched something, its marker was lost, or it
belongs to another motion. No other trial can confirm a cause in it, and its misfit
would hide what the others agree on.
"""

from __future__ import annotations

import numpy as np

from stringcast.stages.diagnose.forward_selection import SelectionState
from stringcast.stages.diagnose.predictions import tip_errors
from stringcast.stages.diagnose.rules import Criteria

MM_PER_M = 1e3
MIN_TRIALS = 4  # three that agree against one
OUTLYING = "the others predict its tip"  # begins the reason
MAX_ERROR_RATIO = 10.0  # to the median of the others; motions alone make it 3 or so


def find_outlying_trial(state: SelectionState, criteria: Criteria) -> dict[str, str]:
    """Find the trial that the others predict far worse than each other.

    Each trial is predicted by a fit to the others, with the causes found.

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
    limit_m = max(criteria.tip_tolerance_m, MAX_ERROR_RATIO * others_m)
    if errors_m[worst] <= limit_m:
        return {}
    reason = (
        f"{OUTLYING} to {MM_PER_M * errors_m[worst]:.0f} mm, "
        f"and each other to {MM_PER_M * others_m:.1f} mm; excluded"
    )
    return {data.trials[worst].name: reason}
