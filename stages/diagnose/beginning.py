"""Trials that begin moving: the state in which each begins, and what is not known of it.

A state is found with the model at hand; a cause, were it known, would have found another. So what another state could
explain says nothing of causes (`Evidence.unsure`), and states are found anew once there is a cause.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stringcast.stages.diagnose.evidence import SHORTER, Evidence, torn, with_shorter_steps
from stringcast.stages.diagnose.fit import Fit
from stringcast.stages.inference.forward import Case
from stringcast.stages.inference.initial_modes import settled, slopes
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import values_of


def move_at_first(evidence: Evidence) -> bool:
    """Whether any trial begins moving."""
    return any(case.initial is not None for case in evidence.cases)


def begun(evidence: Evidence, model: Model, chi: np.ndarray) -> Evidence:
    """With the states that suit these exponents (P,) best, by how the trials go on, as if these were known; as it is if
    all begin at rest."""
    if not move_at_first(evidence):
        return evidence
    values = values_of(model.parameters, chi[None])[0]
    cases = tuple(settled(case, values) for case in _divided(evidence, model, values))
    return replace(evidence, cases=cases, unsure=())


def doubted_beginnings(evidence: Evidence, model: Model, chi: np.ndarray) -> Evidence:
    """With what is not known of these states, about exponents (P,); as it is if all begin at rest."""
    if not move_at_first(evidence):
        return evidence
    values = values_of(model.parameters, chi[None])[0]
    return replace(evidence, unsure=tuple(slopes(case, values) for case in _divided(evidence, model, values)))


def simulated(evidence: Evidence, fit: Fit) -> np.ndarray:
    """Residual (N,) of what is really simulated, from the states that suit a fit: nothing that another beginning could
    explain is taken away."""
    if not move_at_first(evidence):
        return fit.residual
    own = begun(evidence, fit.theory.model, fit.chi)
    return np.asarray(own.residuals(fit.theory.model, fit.chi[None])[0])


def _divided(evidence: Evidence, model: Model, values: np.ndarray) -> list[Case]:
    """The trials with the larger number of segments, and steps that bear these values (P,)."""
    finest = model.divided(evidence.segments[-1])
    return [_borne(replace(case, model=finest), values) for case in evidence.cases]


def _borne(case: Case, values: np.ndarray) -> Case:
    """With shorter steps where the model's tear the string, as candidates are tried."""
    points = next(case.simulate(values[None]))[1].points
    lost = torn(points, case.model.string.length)[0]
    return replace(case, model=with_shorter_steps(case.model, SHORTER)) if lost else case
