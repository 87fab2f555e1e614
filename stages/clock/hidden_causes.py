"""Fits of the clock offset with a hidden cause each, averaged by their evidence.

A weight at the tip or a set changes the motion so much that the best offset without it
is wrong by many milliseconds. Then first order in the cause is not enough: the cause is
fitted together with the offset.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stringcast.stages.diagnose.clocks.clock_offsets import CLOCK_EFFECTS, ClockFit
from stringcast.stages.diagnose.evidence.background_effects import (
    BackgroundPosterior,
    mix_normals,
)
from stringcast.stages.diagnose.search.proposals import (
    candidate_effects,
    propose_causes,
)
from stringcast.stages.inference.laplace import fit_hypothesis
from stringcast.stages.model.effect import is_position_dependent
from stringcast.stages.model.library import effects_by_name

MAX_FITTED_CAUSES = 3
# Least gain in log-likelihood, to first order, for which a cause is fitted. Smaller
# ones belong to the effects in the background.
MIN_GAIN_LOG_LIKELIHOOD = 3.0
# A fit with so much less log evidence than the best has no weight
NEGLIGIBLE_LOG_EVIDENCE = 10.0
PROBE_SEED = 0


def fits_with_causes(clock: ClockFit) -> list[ClockFit]:
    """Fit the offset with each of the causes that explain most.

    Returns the likely fits, the best first. The given fit, without a cause, may be
    among them. Effects that depend on place are left out, because they act only where
    they touch.
    """
    fit = clock.fit
    candidates = candidate_effects(
        fit.hypothesis.model, effects_by_name(), clock.data.trials, CLOCK_EFFECTS
    )
    effects = [effect for effect in candidates if not is_position_dependent(effect)]
    fits = [clock]
    proposals = propose_causes(clock.data, fit, effects, PROBE_SEED)
    for proposal in proposals[:MAX_FITTED_CAUSES]:
        if proposal.gain < MIN_GAIN_LOG_LIKELIHOOD:
            break
        with_cause = fit_hypothesis(
            clock.data, proposal.hypothesis, proposal.starts, fit.grid_points
        )
        fits.append(replace(clock, fit=with_cause))
    fits.sort(key=lambda clock: -clock.fit.log_evidence)
    least = fits[0].fit.log_evidence - NEGLIGIBLE_LOG_EVIDENCE
    return [clock for clock in fits if clock.fit.log_evidence >= least]


def average_by_evidence(
    fits: Sequence[ClockFit], posteriors: Sequence[BackgroundPosterior]
) -> BackgroundPosterior:
    """Average posteriors of the same parameters over fits, weighted by evidence."""
    means = np.array([posterior.mean for posterior in posteriors])
    covariances = np.array([posterior.covariance for posterior in posteriors])
    log_evidence = np.array([clock.fit.log_evidence for clock in fits])
    return mix_normals(means, covariances, log_evidence)
