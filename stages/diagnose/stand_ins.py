"""Whether a cause is there or stands in for something unknown, by what it leaves.

While misfit remains, something outside the library moves the string. A cause that is
not there may do about the same, and then stands in for it. In each trial that the cause
moves, let r be what is left at the tip over what the cause explains there.

- If the cause is there, what is unknown may do any multiple of what it does. r is
  log-uniform, from where the unknown does next to nothing to where it hides the cause.
- If the cause stands in, it explains any share 1 / (1 + r^2) of the misfit. The share
  is uniform between those of the same ratios.

Both are as likely before the data speak. What is left before a discrepancy begins
counts alone where the cause moves the tip before that: there the model holds. Casts of
a set are alike, and so are their ratios. So the mean of the trials' log Bayes factors
counts as one trial.
"""

from __future__ import annotations

import numpy as np

from stringcast.stages.common import rms
from stringcast.stages.inference.discrepancy_grid import onset_time
from stringcast.stages.inference.laplace import Fit, mean_discrepancy
from stringcast.stages.inference.prepared_trial import PreparedTrial
from stringcast.stages.inference.trial_data import TrialData, subtract_by_trial

SMALLEST_RATIO = 0.02  # of what is left to what a cause explains: noise leaves as much
LARGEST_RATIO = 3.0  # the cause then explains a tenth of the mean square misfit


def explained_shares(
    data: TrialData, without: Fit, fit: Fit, min_tip_shift_m: float
) -> np.ndarray:
    """Compute how much of the misfit at the tip a cause explains in each trial.

    Parameters
    ----------
    data : TrialData
    without, fit : Fit
        Without the cause and with it.
    min_tip_shift_m : float
        Trials in which it moves the tip by less do not count [m], nor do those in which
        nothing is left without it.

    Returns
    -------
    numpy.ndarray, shape (trials that count,)
        Shares of the mean square; negative where more is left with the cause.
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
                left = _tip_rms(trial, after[k], frames)
                shares.append(1 - (left / misfit) ** 2)
            break
    return np.array(shares)


def _tip_rms(trial: PreparedTrial, residual: np.ndarray, chosen: np.ndarray) -> float:
    """Compute the root mean square of displacements of chosen points [m].

    residual: over sigma, (2 n,). chosen: a mask, (n,); 0 if it chooses none.
    """
    displacements = trial.displacements_m(residual)[chosen]
    return rms(np.hypot(*displacements.T)) if len(displacements) else 0.0


def probability_by_shares(shares: np.ndarray) -> float:
    """Compute the probability that a cause is there and does not stand in.

    shares: of the mean square misfit that it explains, by trial, (K,).
    """
    if not shares.size:
        return 0.5
    least = 1 / (1 + LARGEST_RATIO**2)
    most = 1 / (1 + SMALLEST_RATIO**2)
    share = np.clip(shares, least, most)
    log_ratios = np.log(LARGEST_RATIO / SMALLEST_RATIO)
    if_there = 1 / (2 * log_ratios * share * (1 - share))
    if_stand_in = 1 / (most - least)
    log_bayes_factor = np.mean(np.log(if_there / if_stand_in))
    return float(1 / (1 + np.exp(-log_bayes_factor)))
