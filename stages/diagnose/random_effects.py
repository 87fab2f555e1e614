"""Causes that differ from trial to trial: the string was picked up anew, or handled in
between.

A cause that comes with that has a size that all trials share, and one of each trial
about it (random effects: Laird and Ware 1982, Biometrics 38, 963). To first order a
trial's own is a displacement of known shape, and its amplitude is integrated out. How
far apart trials are, at the tip, is told by the data; where they are no different, that
is zero.
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
    """Data with what differs from trial to trial of a hypothesis at exponents (P,), as
    far as is likeliest.
    """
    for cause in hypothesis.causes:
        if cause.varies_between_trials:
            here, moved = _responses_per_metre(data, hypothesis, cause, chi)
            widths = [
                tuple(width * each for each in moved) for width in TIP_SHIFT_WIDTHS_M
            ]
            tried = [
                data,
                *(
                    replace(
                        data, random_effects={**data.random_effects, cause.name: each}
                    )
                    for each in widths
                ),
            ]
            data = max(
                tried,
                key=lambda each: marginal_log_likelihood(
                    each.for_hypothesis(hypothesis).log_likelihood_by_scale(here)
                ).sum(),
            )
    return data


def _responses_per_metre(
    data: TrialData, hypothesis: Hypothesis, cause: type[Effect], chi: np.ndarray
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Residuals of each trial, (1, 2 n), and how it moves, over sigma, with the
    components of a cause that move all tips by 1 m, (2 n, m).
    """
    places = hypothesis.parameter_indices(cause, amplitude_parameters(cause))
    beside = np.repeat(chi[None], len(places) + 1, axis=0)
    beside[range(len(places)), places] += np.where(
        chi[places] > 0.5, -solver.FIRST_DIFFERENCE, solver.FIRST_DIFFERENCE
    )
    residuals = data.residuals(hypothesis.model, beside)
    here, moved = (
        [each[-1:] for each in residuals],
        [each[:-1] - each[-1] for each in residuals],
    )
    sizes = np.maximum(data.overall_tip_rms(moved), np.finfo(float).tiny)
    return here, [(each / sizes[:, None]).T for each in moved]
