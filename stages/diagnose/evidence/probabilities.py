"""Probabilities of effects in one slot from their evidence."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

import numpy as np
from scipy.special import logsumexp

NameT = TypeVar("NameT", str, tuple[str, ...])
PRIOR_NO_EFFECT = 0.5  # probability that no effect of the library is active


def effect_probabilities(
    log_evidence: Mapping[NameT, np.ndarray], candidates: int
) -> dict[NameT, float]:
    """Compute the probability of each effect, and of none, from their evidence.

    Parameters
    ----------
    log_evidence : mapping to numpy.ndarray, shape (samples,)
        By name of the effect, or names of several; the name of none is empty.
    candidates : int
        Number of effects that share the prior probability of one being active.

    Returns
    -------
    dict
        Mean probabilities over the samples.
    """
    prior_of_each = (1 - PRIOR_NO_EFFECT) / candidates
    log_posterior = {}
    for name, evidence in log_evidence.items():
        log_posterior[name] = evidence + np.log(
            prior_of_each if name else PRIOR_NO_EFFECT
        )
    total = logsumexp(list(log_posterior.values()), axis=0)
    probabilities = {}
    for name, value in log_posterior.items():
        probabilities[name] = float(np.mean(np.exp(value - total)))
    return probabilities
