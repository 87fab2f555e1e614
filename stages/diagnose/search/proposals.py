"""Proposals of causes to fit, with starts, from what each explains to first order.

Every effect is simulated at a few sizes and places of its range. The fitted parameters
are adapted by a Gauss-Newton step, and the best size is chosen. The gains decide which
causes are fitted, never which are named.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from stringcast.data.lazy_module import LazyModule
from stringcast.stages.diagnose.evidence.linearisation import LinearisedFit
from stringcast.stages.diagnose.search.contact_search import (
    CONTACT_DELAY_S,
    contact_candidates,
    varied_parameters,
)
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import TIP_SHIFT_WIDTHS_M, Fit
from stringcast.stages.inference.prepared_trial import PreparedTrial
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.kept_results import keep_results
from stringcast.stages.model.effect import (
    CameraEffect,
    Effect,
    HandEffect,
    ModelChange,
    is_position_dependent,
)
from stringcast.stages.model.hand import HandMotion
from stringcast.stages.model.model import Model
from stringcast.stages.workers import map_in_workers

qmc = LazyModule("scipy.stats.qmc")  # takes 0.4 s

# Size of a probe, as a fraction of the range, from which the tip shift is scaled
PROBE_FRACTION = 0.03
MIN_PROBE_FRACTION = PROBE_FRACTION**2
PROBE_TIP_SHIFTS_M = TIP_SHIFT_WIDTHS_M[1:3]
NEGLIGIBLE_TIP_SHIFT_M = 1e-7
MAX_EXTRAPOLATION = 2.0  # of a probe's size, within which it is about linear
STARTS_PER_EFFECT = 3
PARAMETER_GRID = (np.arange(8) + 0.5) / 8  # trial exponents of a cause's parameter
REFINEMENT_RADII = (0.06, 0.03, 0.015)  # of a range, around the best contacts
REFINED_CANDIDATES = 4
NEGLIGIBLE_RESPONSE_SIGMAS = 1e-6


@dataclass(frozen=True)
class Proposal:
    """Proposal of a further cause, with starts of its fit.

    Attributes
    ----------
    hypothesis : Hypothesis
        The hypothesis with the cause last.
    starts : numpy.ndarray, shape (C, P)
        Exponents, the most promising first.
    gain : float
        Gain in log-likelihood at the first start, to first order.
    direction : numpy.ndarray, shape (N,)
        White response to the cause that the fitted parameters cannot imitate.
    """

    hypothesis: Hypothesis
    starts: np.ndarray
    gain: float
    direction: np.ndarray

    @property
    def effect(self) -> type[Effect]:
        """The last cause, which is proposed."""
        return self.hypothesis.causes[-1]

    def cosine_similarity(self, other: Proposal) -> float:
        """Compute the cosine between the directions of two proposals.

        Its square is the share of one cause's gain that the other could reach, to first
        order.
        """
        size = float(np.linalg.norm(self.direction) * np.linalg.norm(other.direction))
        product = abs(float(self.direction @ other.direction))
        return product / max(size, np.finfo(float).tiny)


def candidate_effects(
    base: Model,
    library: Mapping[str, type[Effect]],
    trials: Sequence[PreparedTrial],
    excluded: Sequence[str] = (),
) -> list[type[Effect]]:
    """Select the effects of the library that these trials can show.

    Parameters
    ----------
    excluded : sequence of str
        Names of effects that cannot be active.
    """
    left_out = effects_left_out(base, library, trials, excluded)
    return [effect for name, effect in library.items() if name not in left_out]


def effects_left_out(
    base: Model,
    library: Mapping[str, type[Effect]],
    trials: Sequence[PreparedTrial],
    excluded: Sequence[str] = (),
) -> dict[str, str]:
    """Return the reason for each effect that is not a candidate, by name.

    Parameters as of `candidate_effects`.
    """
    has_no_joints = any(isinstance(trial.motion, HandMotion) for trial in trials)
    reasons = {}
    for name, effect in library.items():
        reason = _reason_to_leave_out(effect, base, has_no_joints)
        if name in excluded and effect not in base.effects:
            reason = "diagnose.excluded_effects names it"
        if reason:
            reasons[name] = reason
    return reasons


def _reason_to_leave_out(effect: type[Effect], base: Model, has_no_joints: bool) -> str:
    """Return the reason why trials cannot show an effect; empty if they can."""
    if effect in base.effects:
        return "it is part of the base model"
    if effect.exclusion_reason:
        return effect.exclusion_reason
    if issubclass(effect, ModelChange):
        return "it is a numerical error, which is computed"
    if issubclass(effect, CameraEffect) and effect.corrected_by_calibration:
        return "the calibrated lens corrects it" if base.camera.lens else ""
    if issubclass(effect, HandEffect) and "grasp" not in effect.laws():
        return "it acts on joints, which no trial states" if has_no_joints else ""
    return ""


def propose_causes(
    data: TrialData,
    parent: Fit,
    effects: Sequence[type[Effect]],
    seed: int,
) -> list[Proposal]:
    """Propose effects in addition to those of a fit, the most promising first.

    Effects that cannot act in these trials are left out.

    Parameters
    ----------
    data : TrialData
        Trials, K of them.
    parent : Fit
        The fit without a further cause.
    effects : sequence of type of Effect
        Candidates.
    seed : int
        Seed of the probes.
    """
    linear = LinearisedFit(data, parent)
    qmc.import_now()
    # Contacts first, because their search takes longest
    ordered = sorted(effects, key=is_position_dependent, reverse=True)
    results = map_in_workers(
        lambda effect: _propose_effect(linear, effect, seed), ordered
    )
    by_effect = dict(zip(ordered, results, strict=True))
    proposals = []
    for effect in effects:
        if by_effect[effect]:
            starts, gain, direction = by_effect[effect]
            hypothesis = parent.hypothesis.with_cause(effect)
            proposal = Proposal(hypothesis, starts, float(gain), direction)
            proposals.append(proposal)
    return sorted(proposals, key=lambda proposal: -proposal.gain)


@keep_results
def _propose_effect(
    linear: LinearisedFit, effect: type[Effect], seed: int
) -> tuple[np.ndarray, ...]:
    """Return starts, gain and direction of a proposal; nothing if there is none."""
    if is_position_dependent(effect):
        return _propose_contact(linear, effect, seed)
    return _propose_global_effect(linear, effect, seed)


def alternative_parameter_starts(data: TrialData, fit: Fit) -> np.ndarray:
    """Find starts (C, P) with other values of the causes' parameters.

    Parameters of the place or time of an effect have many local optima.
    """
    linear = LinearisedFit(data, fit)
    hypothesis = fit.hypothesis
    starts = [np.zeros((0, len(fit.chi)))]
    gains = [np.zeros(0)]
    for cause in hypothesis.causes:
        for index in hypothesis.parameter_indices(cause, cause.parameters):
            chi, gain = linear.refit_at_values(index, PARAMETER_GRID)
            starts.append(chi)
            gains.append(gain)
    gain = np.concatenate(gains)
    count = min(int((gain > 0).sum()), STARTS_PER_EFFECT)
    best = np.argsort(-gain, kind="stable")[:count]
    return np.asarray(np.concatenate(starts)[best])


def _propose_global_effect(
    linear: LinearisedFit,
    effect: type[Effect],
    seed: int,
) -> tuple[np.ndarray, ...]:
    """Propose an effect that acts at all places and times.

    Returns the same as `_propose_effect`.
    """
    hypothesis = linear.parent.hypothesis.with_cause(effect)
    start = hypothesis.exponents_from(linear.parent.exponents)
    amplitudes = hypothesis.amplitude_indices(effect)
    chi = _probe_exponents(linear, hypothesis, effect, seed)
    responses = linear.responses(hypothesis, chi)
    steps, remainder = linear.parameter_steps(responses)

    # The best multiple of each probe
    square = np.sum(remainder**2, axis=1)
    negligible = NEGLIGIBLE_RESPONSE_SIGMAS**2
    multiple = -(remainder @ linear.white_residual) / np.maximum(square, negligible)
    amplitude = effect.parameters[0]
    is_two_sided = amplitude.low < amplitude.start < amplitude.high
    least = -MAX_EXTRAPOLATION if is_two_sided else 0.0
    factors = np.clip(multiple, least, MAX_EXTRAPOLATION)
    gain = linear.log_likelihood_gains(responses, steps, factors)
    gain = np.where(square > negligible, gain, -np.inf)

    # The best probes, with the adapted parameters
    order = np.argsort(-gain, kind="stable")[:STARTS_PER_EFFECT]
    best = order[0]
    if not np.isfinite(gain[best]):
        return ()
    starts = chi[order]
    factors = factors[order, None]
    probed = starts[:, amplitudes] - start[amplitudes]
    starts[:, amplitudes] = start[amplitudes] + factors * probed
    names = hypothesis.model.names
    fitted = [names.index(name) for name in linear.parent.exponents]
    starts[:, fitted] += factors * steps[order]
    starts = np.clip(starts, 0.0, 1.0)
    return starts, np.asarray(gain[best]), remainder[best]


def _probe_exponents(
    linear: LinearisedFit,
    hypothesis: Hypothesis,
    effect: type[Effect],
    seed: int,
) -> np.ndarray:
    """Choose exponents (C, P) of an effect with typical tip shifts of causes."""
    start = hypothesis.exponents_from(linear.parent.exponents)
    varied = hypothesis.parameter_indices(effect, varied_parameters(effect))
    amplitudes = hypothesis.amplitude_indices(effect)
    absent = start[amplitudes]

    # Directions: the first amplitude at an end of its range, the others anywhere
    ends = np.array([[0.0], [1.0]])
    if len(varied) > 1:
        ends = qmc.Sobol(len(varied), seed=seed).random_base2(len(varied) + 1)
        ends[:, 0] = np.round(ends[:, 0])
    probes = np.repeat(start[None], len(ends), axis=0)
    probes[:, varied] = ends
    distance = probes[:, amplitudes] - absent
    is_active = np.abs(distance).max(axis=1) > 0
    probes = probes[is_active]
    distance = distance[is_active]

    # Sizes: scale them by the tip shift at a small fraction
    probes[:, amplitudes] = absent + PROBE_FRACTION * distance
    shift_m = linear.data.overall_tip_rms(linear.responses(hypothesis, probes))
    shift_m = np.maximum(shift_m, NEGLIGIBLE_TIP_SHIFT_M)
    scaled = []
    for wanted_m in PROBE_TIP_SHIFTS_M:
        fraction = PROBE_FRACTION * wanted_m / shift_m
        fraction = np.clip(fraction, MIN_PROBE_FRACTION, 1.0)
        probes[:, amplitudes] = absent + fraction[:, None] * distance
        scaled.append(probes.copy())
    return np.unique(np.concatenate(scaled), axis=0)


def _propose_contact(
    linear: LinearisedFit,
    effect: type[Effect],
    seed: int,
) -> tuple[np.ndarray, ...]:
    """Propose an effect that depends on place, such as a plane that the string hits.

    An effect that acts from any place, such as a spring to a fixed point, is proposed
    like those that do not depend on place.

    Candidates touch the string when it departs from the fit. The search is refined
    around those that explain most until shortly after the departure, because the later
    motion depends on everything. The fitted parameters are not adapted.
    """
    hypothesis = linear.parent.hypothesis.with_cause(effect)
    rng = np.random.default_rng(seed)
    contacts = contact_candidates(linear.data, linear.parent, hypothesis, seed)
    if contacts.act_everywhere():
        return _propose_global_effect(linear, effect, seed)
    if not np.isfinite(contacts.departure_times).any():
        return ()  # the string never departs from the fit
    end_times = contacts.departure_times + CONTACT_DELAY_S
    chi = contacts.sample()
    tried = []
    gains = []
    for radius in (*REFINEMENT_RADII, 0.0):
        if not len(chi):
            return ()
        tried.append(chi)
        responses = linear.responses(hypothesis, chi)
        gains.append(linear.early_gains(responses, end_times))
        order = np.argsort(-np.concatenate(gains), kind="stable")
        best = np.concatenate(tried)[order]
        if radius:
            chi = contacts.sample_near(best[:REFINED_CANDIDATES], radius, rng)

    starts = best[:STARTS_PER_EFFECT]
    responses = linear.responses(hypothesis, starts)
    no_steps = np.zeros((len(starts), len(linear.parent.chi)))
    factors = np.ones(len(starts))
    gain = linear.log_likelihood_gains(responses, no_steps, factors).max()
    if not np.isfinite(gain):
        return ()
    _, remainder = linear.parameter_steps(responses)
    return starts, np.asarray(gain), remainder[0]
