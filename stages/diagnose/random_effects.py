"""Causes that differ from trial to trial, as when the string is picked up again.

Such a cause has an amplitude that all trials share, and one of each trial about it
(random effects: Laird and Ware, Biometrics 38, 963, 1982). To first order the latter is
a displacement of known shape whose amplitude is integrated out. The data determine how
far trials differ at the tip; that may be zero.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stringcast.stages.inference import solver
from stringcast.stages.inference.discrepancy import marginal_log_likelihood
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import TIP_SHIFT_WIDTHS_M
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.effect import Effect, amplitude_parameters


def with_random_effects(
    data: TrialData, hypothesis: Hypothesis, chi: np.ndarray
) -> TrialData:
    """Add random effects of a hypothesis at exponents (P,), of the likeliest widths."""
    for cause in hypothesis.causes:
        if not cause.varies_between_trials:
            continue
        residuals, shapes = _shapes_per_metre(data, hypothesis, cause, chi)
        candidates = [data]
        for width_m in TIP_SHIFT_WIDTHS_M:
            widened = tuple(width_m * shape for shape in shapes)
            effects = {**data.random_effects, cause.name: widened}
            candidates.append(replace(data, random_effects=effects))
        log_likelihoods = []
        for candidate in candidates:
            extended = candidate.for_hypothesis(hypothesis)
            by_scale = extended.log_likelihood_by_scale(residuals)
            log_likelihoods.append(marginal_log_likelihood(by_scale).sum())
        data = candidates[int(np.argmax(log_likelihoods))]
    return data


def _shapes_per_metre(
    data: TrialData, hypothesis: Hypothesis, cause: type[Effect], chi: np.ndarray
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Simulate how the amplitudes of a cause move each trial by 1 m at the tip.

    Returns
    -------
    residuals : list of numpy.ndarray, shape (1, 2 n)
    shapes : list of numpy.ndarray, shape (2 n, m)
        Over sigma.
    """
    indices = hypothesis.parameter_indices(cause, amplitude_parameters(cause))
    step = solver.FIRST_DIFFERENCE
    exponents = np.repeat(chi[None], len(indices) + 1, axis=0)
    signed_steps = np.where(chi[indices] > 0.5, -step, step)
    exponents[range(len(indices)), indices] += signed_steps
    simulated = data.residuals(hypothesis.model, exponents)
    residuals = [each[-1:] for each in simulated]
    changes = [each[:-1] - each[-1] for each in simulated]
    shift_m = np.maximum(data.overall_tip_rms(changes), np.finfo(float).tiny)
    return residuals, [(change / shift_m[:, None]).T for change in changes]
