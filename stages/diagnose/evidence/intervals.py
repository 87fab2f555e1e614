"""Intervals and correlations of the parameters of a fit."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Any

import numpy as np

from stringcast.stages.diagnose.evidence.background_effects import (
    Background,
    BackgroundPosterior,
    posterior_with_background,
)
from stringcast.stages.inference.laplace import Fit, hypothesis_likelihood
from stringcast.stages.inference.likelihood import PRIOR_PRECISION
from stringcast.stages.inference.profile import profile_reaches
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.kept_results import keep_results

MIN_SHOWN_CORRELATION = 0.8


def parameter_uncertainty(
    data: TrialData,
    fit: Fit,
    background: Background,
    half_width: float,
) -> dict[str, Any]:
    """Collect the intervals and large correlations of a fit's parameters.

    Parameters
    ----------
    data : TrialData
        The data of the fit.
    background : Background
        Small amounts of other effects.
    half_width : float
        Half width of the intervals in standard deviations.

    Returns
    -------
    dict
        For diagnosis.json: intervals by name, and the most correlated pairs first.
    """
    posterior = posterior_with_background(data, fit, background)
    reaches = _interval_reaches(data, fit, posterior, half_width)
    intervals = {}
    for parameter, name, chi, (below, above) in zip(
        fit.hypothesis.parameters,
        fit.hypothesis.model.names,
        fit.chi,
        reaches,
        strict=True,
    ):
        ends = np.clip([chi - below, chi + above], 0.0, 1.0)
        intervals[name] = parameter.value(ends).tolist()

    names = list(intervals)
    correlations: list[dict[str, Any]] = []
    for i, j in combinations(range(len(names)), 2):
        value = float(posterior.correlation[i, j])
        if abs(value) > MIN_SHOWN_CORRELATION:
            correlations.append({"parameters": [names[i], names[j]], "value": value})
    correlations.sort(key=lambda row: -abs(row["value"]))
    return {"intervals": intervals, "correlations": correlations}


def _interval_reaches(
    data: TrialData, fit: Fit, posterior: BackgroundPosterior, half_width: float
) -> np.ndarray:
    """Compute how far the interval of each exponent reaches below and above, (P, 2).

    The distance of the fit from the posterior mean is added as a bias. Intervals of
    causes' parameters also follow the profile likelihood.
    """
    bias = posterior.mean - fit.chi
    reach = half_width * np.hypot(posterior.standard_deviation, bias)
    reaches = np.repeat(reach[:, None], 2, axis=1)
    base = fit.hypothesis.base_indices
    others = np.setdiff1d(np.arange(len(fit.chi)), base).tolist()
    if others:
        followed = _profile_reaches(data, fit, others, half_width)
        reaches[others] = np.maximum(reaches[others], followed)
    return reaches


@keep_results
def _profile_reaches(
    data: TrialData, fit: Fit, indices: Sequence[int], half_width: float
) -> np.ndarray:
    """Compute how far profile intervals of some exponents reach, (I, 2)."""
    likelihood = hypothesis_likelihood(data, fit.hypothesis, fit.grid_points)
    white_slopes = likelihood.data.whiten(fit.slopes, fit.grid_points)
    precision = white_slopes @ white_slopes.T
    base = fit.hypothesis.base_indices
    precision[base, base] += PRIOR_PRECISION
    return profile_reaches(likelihood, fit.chi, precision, indices, half_width)
