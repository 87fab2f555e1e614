"""Evidence of rivals on the same data: what was measured, with nothing subtracted.

A search subtracts the numerical error at the optimum of a fit from what was measured.
Each rival then has data of its own, and how far this error is from that where the fit
ends moves log evidences by up to hundreds: more than rivals differ. So rivals are
compared by simulations that are extrapolated from two meshes. Initial states, noise and
discrepancy are those of one search; what is uncertain in the extrapolation is part of
the likelihood. A rival may be in a worse minimum of the parameters that all share, so
that it is also fitted from those of the most evident other one, on one mesh; it starts
from the more likely of both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stringcast.stages.diagnose.discrepancy_model import with_random_effects
from stringcast.stages.diagnose.prepared_data import PreparedData
from stringcast.stages.diagnose.rules import NEGLIGIBLE_LOG_EVIDENCE
from stringcast.stages.inference.extrapolated_data import ExtrapolatedData
from stringcast.stages.inference.initial_modes import reset_initial_state_linear
from stringcast.stages.inference.laplace import (
    Fit,
    best_exponents,
    fit_hypothesis,
    log_likelihoods,
)
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.workers import map_in_workers


def fit_to_common_data(prepared: PreparedData, rivals: Sequence[Fit]) -> list[Fit]:
    """Fit each rival to what was measured.

    Parameters
    ----------
    prepared : PreparedData
        The data of the search, with their initial states and error models.
    rivals : sequence of Fit
        What is compared, such as hypotheses with and without a cause.

    Returns
    -------
    list of Fit
        In the order of the rivals.
    """
    data = measured_data(prepared)

    def fit_rival(number: int) -> Fit:
        rival = rivals[number]
        hypothesis = rival.hypothesis
        others = [other for other in rivals if other is not rival]
        best = max(others, key=lambda other: other.log_evidence)
        shared = hypothesis.exponents_from(rival.exponents | best.exponents)
        elsewhere, _ = best_exponents(
            prepared.data,
            hypothesis,
            shared[None],
            rival.scale_indices,
            NEGLIGIBLE_LOG_EVIDENCE,
        )
        starts = np.stack([rival.chi, elsewhere])
        own_data = with_random_effects(data, hypothesis, rival.chi)
        log_likelihood = log_likelihoods(own_data, hypothesis, starts)
        return fit_hypothesis(
            own_data,
            hypothesis,
            starts[[np.argmax(log_likelihood)]],
            rival.scale_indices,
            NEGLIGIBLE_LOG_EVIDENCE,
        )

    fits = []
    fitted = map_in_workers(fit_rival, range(len(rivals)))
    for rival, fit in zip(rivals, fitted, strict=True):
        # A worker returns a copy of the hypothesis
        fits.append(replace(fit, hypothesis=rival.hypothesis))
    return fits


def measured_data(prepared: PreparedData) -> TrialData:
    """Undo the subtraction of numerical error, and simulate without it instead."""
    if prepared.mesh_is_model:
        return prepared.data
    trials = []
    for measured, corrected in zip(prepared.trials, prepared.data.trials, strict=True):
        trial = replace(corrected, points=measured.points)
        shapes = trial.discrepancy.nuisance_shapes
        trials.append(reset_initial_state_linear(trial, shapes))
    return ExtrapolatedData(tuple(trials), prepared.data.random_effects)
