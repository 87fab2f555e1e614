"""Evidence of rivals on common data.

Each rival is refined on data from which the numerical error at its own optimum was
subtracted. What is uncertain in that error moves log evidences by up to hundreds, for
all rivals alike: more than rivals differ. So every rival is also fitted to the data of
every other one, and compared with those that were fitted to the same data (randomised
blocks [1]_, common random numbers). Which data are right is not known: each are as
probable (`posteriors`).

References
----------
.. [1] Box, Hunter, Hunter, Statistics for Experimenters (2005), chapter 4.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from stringcast.stages.diagnose.discrepancy_model import with_random_effects
from stringcast.stages.diagnose.rules import NEGLIGIBLE_LOG_EVIDENCE
from stringcast.stages.inference.laplace import Fit, fit_hypothesis
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.workers import map_in_workers


def fit_to_common_data(
    fits: Mapping[str, Fit], data: Mapping[str, TrialData]
) -> dict[str, dict[str, Fit]]:
    """Fit each rival to the data of each, where its own fit stays.

    Parameters
    ----------
    fits : dict
        The rivals by name, and others that are compared with them.
    data : dict
        By name of a rival, as corrected at its fit.

    Returns
    -------
    dict of dict
        On the data of each rival, all fits by name.
    """
    pairs = [(owner, name) for owner in data for name in fits if name != owner]

    def fit_pair(pair: tuple[str, str]) -> Fit:
        owner, name = pair
        return fit_to_data_of(data[owner], fits[owner], fits[name])

    fits_by_data = {owner: dict(fits) for owner in data}
    for pair, fit in zip(pairs, map_in_workers(fit_pair, pairs), strict=True):
        owner, name = pair
        # A worker returns a copy of the hypothesis
        hypothesis = fits[name].hypothesis
        fits_by_data[owner][name] = replace(fit, hypothesis=hypothesis)
    return fits_by_data


def fit_to_data_of(data: TrialData, owner: Fit, rival: Fit) -> Fit:
    """Fit a rival to the data of another fit, from its own optimum and from that."""
    hypothesis = rival.hypothesis
    common = with_random_effects(data, hypothesis, rival.chi)
    shared = hypothesis.exponents_from({**rival.exponents, **owner.exponents})
    return fit_hypothesis(
        common,
        hypothesis,
        np.stack([rival.chi, shared]),
        owner.scale_indices,
        NEGLIGIBLE_LOG_EVIDENCE,
    )
