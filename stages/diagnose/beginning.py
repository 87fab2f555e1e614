"""Trials that begin moving: the state in which each begins, and what is not known of it.

A state is found with the model at hand; a cause, were it known, would have found another. So what another state could
explain says nothing of causes (`Evidence.unsure`), and states are found anew once there is a cause.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stages.diagnose.evidence import Evidence
from stages.estimate.result import values_of
from stages.estimate.settle import settled, slopes
from stages.model.model import Model


def begun(evidence: Evidence, model: Model, chi: np.ndarray) -> Evidence:
    """With the states that suit these exponents (P,) best, by how the trials go on."""
    divided, values = model.divided(evidence.segments[-1]), values_of(model.parameters, chi[None])[0]
    return replace(evidence, cases=tuple(settled(replace(case, model=divided), values) for case in evidence.cases))


def doubted_beginnings(evidence: Evidence, model: Model, chi: np.ndarray) -> Evidence:
    """With what is not known of these states, about exponents (P,)."""
    divided, values = model.divided(evidence.segments[-1]), values_of(model.parameters, chi[None])[0]
    unsure = tuple(slopes(replace(case, model=divided), values) for case in evidence.cases)
    return replace(evidence, unsure=unsure)


def move_at_first(evidence: Evidence) -> bool:
    """Whether any trial begins moving."""
    return any(case.initial is not None for case in evidence.cases)
