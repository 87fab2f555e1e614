"""Where a fit of one more cause may start: what each effect would explain of the
residual, to first order.

Every effect is tried at a few sizes and places of its range. What the fitted parameters
would do about it is counted in (a Gauss-Newton step), and its size is taken where it
explains most. Such scores say what is worth a fit, never what is named: of 26 causes
that proved right they were 0.02 to 1.1 times what a fit then gained.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

from stringcast.stages.diagnose.contact_search import (
    CONTACT_DELAY_S,
    contact_candidates,
    varied_parameters,
)
from stringcast.stages.diagnose.linearisation import LinearisedFit
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import TIP_SHIFT_WIDTHS_M, Fit
from stringcast.stages.inference.prepared_trial import PreparedTrial
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.effect import (
    CameraEffect,
    Effect,
    HandEffect,
    ModelChange,
    amplitude_parameters,
    is_position_dependent,
)
from stringcast.stages.model.hand import HandMotion
from stringcast.stages.model.model import Model

# of the way from absent to the end of the range, where it is looked how far an effect
# moves the tip
PROBE_FRACTION = 0.03
PROBE_TIP_SHIFTS_M = TIP_SHIFT_WIDTHS_M[1:3]  # [m] at the tip that it is tried at
NEGLIGIBLE_TIP_SHIFT_M = 1e-7  # [m] at the tip: it does nothing
# times a probe's size that it may be taken at, where it is still about linear
MAX_EXTRAPOLATION = 2.0
STARTS_PER_EFFECT = 3  # of an effect's fit
# of its range, at which a parameter of a cause is tried anew
PARAMETER_GRID = (np.arange(8) + 0.5) / 8
# of a range, within which places are tried about the best ones
REFINEMENT_RADII = (0.06, 0.03, 0.015)
REFINED_CANDIDATES = 4  # how many of these
# standard deviations: what moves nothing explains nothing
NEGLIGIBLE_RESPONSE_SIGMAS = 1e-6


@dataclass(frozen=True)
class Proposal:
    """One more cause. starts: (C, P) exponents, the most promising first. gain: of the
    log-likelihood there, to first order. direction: what it does for a unit of it that
    the fitted parameters cannot, white, (N,).
    """

    hypothesis: Hypothesis
    starts: np.ndarray
    gain: float
    direction: np.ndarray

    @property
    def effect(self) -> type[Effect]:
        """The cause."""
        return self.hypothesis.causes[-1]

    def cosine_similarity(self, other: Proposal) -> float:
        """Cosine between what both do that the fitted parameters cannot: its square is
        the share of what one explains that the other could, to first order.
        """
        size = float(np.linalg.norm(self.direction) * np.linalg.norm(other.direction))
        return abs(float(self.direction @ other.direction)) / max(
            size, np.finfo(float).tiny
        )


def candidate_effects(
    base: Model,
    library: Mapping[str, type[Effect]],
    trials: Sequence[PreparedTrial],
    excluded_effects: Sequence[str] = (),
) -> list[type[Effect]]:
    """Effects with parameters that are not in the base model and not excluded; of those
    on joints, only where there are joints; of those of a lens, only where it was not
    measured. excluded_effects: names of those that cannot be at work.
    """
    grasp_only = any(isinstance(trial.motion, HandMotion) for trial in trials)
    return [
        e
        for e in library.values()
        if e not in base.effects
        and not e.excluded_from_search
        and e.name not in excluded_effects
        and not issubclass(e, ModelChange)
        and not (
            base.camera.lens
            and issubclass(e, CameraEffect)
            and e.corrected_by_calibration
        )
        and not (grasp_only and issubclass(e, HandEffect) and "grasp" not in e.laws())
    ]


def propose_causes(
    data: TrialData, parent: Fit, effects: Sequence[type[Effect]], seed: int
) -> list[Proposal]:
    """Of each effect beside those at work, the most promising first; none of what can
    act nowhere in these trials.
    """
    linear = LinearisedFit(data, parent)
    found = [
        _propose_contact(linear, e, seed)
        if is_position_dependent(e)
        else _propose_global_effect(linear, e, seed)
        for e in effects
    ]
    return sorted(
        (each for each in found if each is not None), key=lambda each: -each.gain
    )


def alternative_parameter_starts(data: TrialData, fit: Fit) -> np.ndarray:
    """Exponents (C, P) at which a parameter of a cause has another value, where that
    promises more: the most promising first. What says when or where leaves ridges and
    plains, on which a search by slopes ends.
    """
    linear, hypothesis = LinearisedFit(data, fit), fit.hypothesis
    places = [
        place
        for cause in hypothesis.causes
        for place in hypothesis.parameter_indices(cause, cause.parameters)
    ]
    found = [
        (np.zeros((0, len(fit.chi))), np.zeros(0)),
        *(linear.refit_at_values(place, PARAMETER_GRID) for place in places),
    ]
    chi, gain = (np.concatenate(each) for each in zip(*found, strict=True))
    return np.asarray(
        chi[np.argsort(-gain, kind="stable")][: int((gain > 0).sum())][
            :STARTS_PER_EFFECT
        ]
    )


def _propose_global_effect(
    linear: LinearisedFit, effect: type[Effect], seed: int
) -> Proposal | None:
    """Of an effect that acts wherever the string is: at several sizes to both sides, at
    any time.
    """
    hypothesis = linear.parent.hypothesis.with_cause(effect)
    start = hypothesis.exponents_from(linear.parent.exponents)
    size, chi = (
        hypothesis.parameter_indices(effect, amplitude_parameters(effect)),
        _probe_exponents(linear, hypothesis, effect, seed),
    )
    responses = linear.responses(hypothesis, chi)
    step, beyond = linear.parameter_steps(responses)
    square = np.sum(beyond**2, axis=1)
    first = effect.parameters[0]
    least = -MAX_EXTRAPOLATION if first.low < first.start < first.high else 0.0
    times = np.clip(
        -(beyond @ linear.white_residual)
        / np.maximum(square, NEGLIGIBLE_RESPONSE_SIGMAS**2),
        least,
        MAX_EXTRAPOLATION,
    )
    gain = np.where(
        square > NEGLIGIBLE_RESPONSE_SIGMAS**2,
        linear.log_likelihood_gains(responses, step, times),
        -np.inf,
    )
    order = np.argsort(-gain, kind="stable")[:STARTS_PER_EFFECT]
    if not np.isfinite(gain[order[0]]):
        return None
    starts, times = chi[order], times[order, None]
    starts[:, size] = start[size] + times * (starts[:, size] - start[size])
    # and the fitted parameters as they suit that
    fitted = [hypothesis.model.names.index(name) for name in linear.parent.exponents]
    starts[:, fitted] += times * step[order]
    return Proposal(
        hypothesis, np.clip(starts, 0.0, 1.0), float(gain[order[0]]), beyond[order[0]]
    )


def _probe_exponents(
    linear: LinearisedFit, hypothesis: Hypothesis, effect: type[Effect], seed: int
) -> np.ndarray:
    """Exponents (C, P) at which an effect is tried: such that it moves the tip as far
    as causes may well do.
    """
    start = hypothesis.exponents_from(linear.parent.exponents)
    own, size = (
        hypothesis.parameter_indices(effect, varied_parameters(effect)),
        hypothesis.parameter_indices(effect, amplitude_parameters(effect)),
    )
    ends = np.array([[0.0], [1.0]])
    if len(own) > 1:
        ends = qmc.Sobol(len(own), seed=seed).random_base2(len(own) + 1)
        ends[:, 0] = np.round(ends[:, 0])
    rows = np.repeat(start[None], len(ends), axis=0)
    rows[:, own] = ends
    away = rows[:, size] - start[size]
    rows, away = rows[np.abs(away).max(axis=1) > 0], away[np.abs(away).max(axis=1) > 0]
    rows[:, size] = start[size] + PROBE_FRACTION * away
    moves = linear.data.overall_tip_rms(linear.responses(hypothesis, rows))
    found = []
    for width in PROBE_TIP_SHIFTS_M:
        share = np.clip(
            PROBE_FRACTION * width / np.maximum(moves, NEGLIGIBLE_TIP_SHIFT_M),
            PROBE_FRACTION**2,
            1.0,
        )
        rows[:, size] = start[size] + share[:, None] * away
        found.append(rows.copy())
    return np.unique(np.concatenate(found), axis=0)


def _propose_contact(
    linear: LinearisedFit, effect: type[Effect], seed: int
) -> Proposal | None:
    """Of an effect that depends on place: where it touches the string when that
    departs, ever closer about the places that explain most until shortly after. What
    happens later depends on everything; the parameters stay as they are.
    """
    hypothesis, rng = (
        linear.parent.hypothesis.with_cause(effect),
        np.random.default_rng(seed),
    )
    places = contact_candidates(linear.data, linear.parent, hypothesis, seed)
    chi, found = places.sample(), []
    for reach in (*REFINEMENT_RADII, 0.0):
        if not len(chi):
            return None
        found.append(
            (
                chi,
                linear.early_gains(
                    linear.responses(hypothesis, chi),
                    places.departure_times + CONTACT_DELAY_S,
                ),
            )
        )
        starts, early = (np.concatenate(each) for each in zip(*found, strict=True))
        starts = starts[np.argsort(-early, kind="stable")]
        chi = (
            places.sample_near(starts[:REFINED_CANDIDATES], reach, rng)
            if reach
            else chi
        )
    responses = linear.responses(hypothesis, starts[:STARTS_PER_EFFECT])
    same = np.zeros((len(responses[0]), len(linear.parent.chi)))
    gain = linear.log_likelihood_gains(responses, same, np.ones(len(same))).max()
    if not np.isfinite(gain):
        return None
    return Proposal(
        hypothesis,
        starts[:STARTS_PER_EFFECT],
        float(gain),
        linear.parameter_steps(responses)[1][0],
    )
