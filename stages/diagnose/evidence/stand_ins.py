"""The probability that a cause is not a stand-in, from the remaining misfit.

If misfit remains, something outside the library moves the string. A cause with about
the same effect may then be accepted as its stand-in. In each trial in which the cause
acts, let r be the remaining misfit at the tip over the displacement that the cause
explains.

- If the cause is present, the unknown effect may have any size relative to it. r is
  log-uniform, from a negligible unknown effect to one that hides the cause.
- If the cause is a stand-in, it explains any share 1 / (1 + r^2) of the misfit. The
  share is uniform between those of the same limits of r.

Both have the same prior probability. If the cause moves the tip before the onset of the
discrepancy, only the time before the onset is used, because there the model holds.
Casts of a dataset are similar, and so are their ratios. So the mean of the trials' log
Bayes factors counts like one trial.
"""

from __future__ import annotations

import numpy as np

from stringcast.stages.common import rms
from stringcast.stages.inference.discrepancy_grid import onset_time
from stringcast.stages.inference.laplace import Fit, mean_discrepancy
from stringcast.stages.inference.prepared_trial import PreparedTrial
from stringcast.stages.inference.trial_data import TrialData, subtract_by_trial

SMALLEST_RATIO = 0.02  # of remaining to explained displacement: the level of noise
LARGEST_RATIO = 3.0  # the cause then explains a tenth of the mean square misfit


def explained_shares(
    data: TrialData, without: Fit, fit: Fit, min_tip_shift_m: float
) -> np.ndarray:
    """Compute the share of the misfit at the tip that a cause explains in each trial.

    Parameters
    ----------
    without, fit : Fit
        The fits without the cause and with it.
    min_tip_shift_m : float
        Trials in which the cause moves the tip by less are left out [m], and those
        without misfit.

    Returns
    -------
    numpy.ndarray, shape (remaining trials,)
        Shares of the mean square; negative if the cause increases the misfit.
    """
    before = mean_discrepancy(data, without)
    after = mean_discrepancy(data, fit)
    moved = subtract_by_trial(without.residuals, fit.residuals)
    shares = []
    for k, trial in enumerate(data.trials):
        has_begun = trial.point_times >= onset_time(trial.times, fit.grid_points[k])
        while_model_holds = trial.is_tip & ~has_begun
        for frames in (while_model_holds, trial.is_tip):
            if _tip_rms(trial, moved[k], frames) < min_tip_shift_m:
                continue
            misfit = _tip_rms(trial, before[k], frames)
            if misfit > 0:
                remaining = _tip_rms(trial, after[k], frames)
                shares.append(1 - (remaining / misfit) ** 2)
            break
    return np.array(shares)


def _tip_rms(trial: PreparedTrial, residual: np.ndarray, chosen: np.ndarray) -> float:
    """Compute the root mean square displacement of chosen points [m], or 0 if none.

    residual: displacements over sigma, (2 n,). chosen: a mask, (n,).
    """
    displacements = trial.displacements_m(residual)[chosen]
    return rms(np.hypot(*displacements.T)) if len(displacements) else 0.0


def probability_by_shares(shares: np.ndarray) -> float:
    """Compute the probability that a cause is present and not a stand-in.

    shares: shares of the mean square misfit that it explains, by trial, (K,).
    """
    if not shares.size:
        return 0.5
    least = 1 / (1 + LARGEST_RATIO**2)
    most = 1 / (1 + SMALLEST_RATIO**2)
    share = np.clip(shares, least, most)
    log_ratios = np.log(LARGEST_RATIO / SMALLEST_RATIO)
    if_present = 1 / (2 * log_ratios * share * (1 - share))
    if_stand_in = 1 / (most - least)
    log_bayes_factor = np.mean(np.log(if_present / if_stand_in))
    return float(1 / (1 + np.exp(-log_bayes_factor)))
