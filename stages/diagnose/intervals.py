"""Intervals of the parameters of a fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stringcast.stages.diagnose.background_effects import BackgroundPosterior
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import Fit
from stringcast.stages.inference.likelihood import Likelihood
from stringcast.stages.inference.profile import profile_reaches
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.kept_results import keep_results


def parameter_intervals(
    data: TrialData,
    fit: Fit,
    posterior: BackgroundPosterior,
    half_width: float,
) -> list[tuple[float, float]]:
    """Compute the ends of each parameter's interval about its value.

    Parameters of causes may reach farther than a normal posterior.

    Parameters
    ----------
    data : TrialData
        To which the fit belongs.
    fit : Fit
    posterior : BackgroundPosterior
        Of its exponents. The fit is not its mean, so that the error of the fit has a
        mean as well.
    half_width : float
        Of the intervals, in standard deviations.
    """
    hypothesis = fit.hypothesis
    bias = posterior.mean - fit.chi
    reach = half_width * np.hypot(posterior.standard_deviation, bias)
    reaches = np.repeat(reach[:, None], 2, axis=1)
    others = np.setdiff1d(np.arange(len(fit.chi)), hypothesis.base_indices).tolist()
    if others:
        followed = _reaches_of(
            data, hypothesis, fit.chi, fit.width, fit.grid_points, others, half_width
        )
        reaches[others] = np.maximum(reaches[others], followed)

    intervals = []
    for parameter, chi, (below, above) in zip(
        hypothesis.parameters, fit.chi, reaches, strict=True
    ):
        low, high = parameter.value(np.clip([chi - below, chi + above], 0.0, 1.0))
        intervals.append((float(low), float(high)))
    return intervals


@keep_results
def _reaches_of(
    data: TrialData,
    hypothesis: Hypothesis,
    chi: np.ndarray,
    width: np.ndarray,
    grid_points: np.ndarray,
    indices: Sequence[int],
    half_width: float,
) -> np.ndarray:
    """Compute how far some exponents of a fit reach below and above, (I, 2)."""
    likelihood = Likelihood(
        data.for_hypothesis(hypothesis),
        hypothesis.model,
        grid_points,
        uniform_indices=hypothesis.base_indices,
    )
    return profile_reaches(likelihood, chi, width, indices, half_width)
