"""The verdict: a pure function of a few numbers, and the computation of these."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from stringcast.stages.common import MM_PER_M, readable_name
from stringcast.stages.diagnose.clocks.clock_offsets import Interval
from stringcast.stages.diagnose.evidence.background_effects import (
    Background,
    find_background,
)
from stringcast.stages.diagnose.evidence.measures import (
    mean_explained_fraction,
    refit,
    unexplained_tip_rms,
)
from stringcast.stages.diagnose.evidence.posteriors import Posteriors
from stringcast.stages.diagnose.evidence.single_effect import (
    SingleEffectPosterior,
    bootstrap_weights,
    inclusion_probabilities,
    single_effect_posterior,
)
from stringcast.stages.diagnose.rules import (
    Criteria,
    VerdictNumbers,
    agreement_is_resolved,
    can_be_confirmed,
    can_be_simulated,
    explains_enough,
    misfit_remains,
    predicts_better,
    unresolved_by_simulation,
)
from stringcast.stages.diagnose.search.selection_state import SelectionState
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import (
    DISCREPANCY_DRAWS,
    Fit,
    sample_discrepancy_tip_rms,
)
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.effect import Effect

RESOLUTION = "resolution"  # name of the cause if the configured mesh is too coarse


@dataclass(frozen=True)
class Verdict:
    """Conclusion of a diagnosis.

    Attributes
    ----------
    kind : str
        none, effect, ambiguous, partial, unknown or insufficient.
    misfit_probability : float
        Probability that the misfit of the resulting model exceeds the tolerance.
    causes : tuple of str
        Named causes, in the order of acceptance, with their look-alikes.
    lookalike_groups : tuple of tuple of str
        Effects that explain the trials about equally well.
    remark : str
        A further sentence.
    """

    kind: str
    misfit_probability: float
    causes: tuple[str, ...] = ()
    lookalike_groups: tuple[tuple[str, ...], ...] = ()
    remark: str = ""


def decide_verdict(numbers: VerdictNumbers, criteria: Criteria) -> Verdict:
    """Name causes that explain the trials and that other trials confirm."""
    return require_confirmation(name_causes(numbers, criteria), numbers)


def name_causes(numbers: VerdictNumbers, criteria: Criteria) -> Verdict:
    """Name the accepted causes if they explain enough of the misfit."""
    if not can_be_simulated(numbers):
        remark = "A trial cannot be simulated with the parameters that fit the others."
        return Verdict("insufficient", numbers.misfit_probability, remark=remark)

    named = dict.fromkeys(chain(*numbers.credible_sets))
    if numbers.causes and named and explains_enough(numbers, criteria):
        groups = tuple(group for group in numbers.credible_sets if len(group) > 1)
        kind = "ambiguous" if groups else "effect"
        if misfit_remains(numbers.misfit_probability):
            kind = "partial"
        return Verdict(kind, numbers.misfit_probability, tuple(named), groups)

    if misfit_remains(numbers.base_misfit_probability):
        remark = _closest_explanation(numbers)
        return Verdict("unknown", numbers.base_misfit_probability, remark=remark)
    if numbers.mesh_too_coarse:
        return Verdict("effect", numbers.base_misfit_probability, (RESOLUTION,))
    if not agreement_is_resolved(numbers):
        remark = _uncertain_simulation_remark(numbers)
        return Verdict("insufficient", numbers.base_misfit_probability, remark=remark)
    return Verdict("none", numbers.base_misfit_probability)


def require_confirmation(verdict: Verdict, numbers: VerdictNumbers) -> Verdict:
    """Withdraw causes that no other trial confirms or that do not improve predictions.

    That the mesh is too coarse needs no confirmation.
    """
    causes = verdict.causes
    names_nothing = verdict.kind in ("none", "insufficient")
    if names_nothing or causes == (RESOLUTION,):
        return verdict
    if not can_be_confirmed(numbers):
        remark = _single_trial_remark(numbers)
        return Verdict("insufficient", verdict.misfit_probability, remark=remark)
    if causes and not predicts_better(numbers):
        remark = (
            "The best explanation of these trials does not predict trials left out."
        )
        return Verdict("unknown", verdict.misfit_probability, remark=remark)
    return verdict


def _closest_explanation(numbers: VerdictNumbers) -> str:
    names = numbers.causes
    if not names or numbers.explained_fraction < 0:
        return ""
    explanation = " with ".join(map(readable_name, names))
    return (
        f"The closest explanation, {explanation}, removes "
        f"{100 * numbers.explained_fraction:.0f} % of the mean square misfit."
    )


def _single_trial_remark(numbers: VerdictNumbers) -> str:
    remark = "No cause is named from a single trial: no other trial can confirm it."
    if not agreement_is_resolved(numbers):
        return f"{remark} {_uncertain_simulation_remark(numbers)}"
    likely = _probable_effects(numbers)
    return f"{remark} In this trial it would be {likely}." if likely else remark


def _uncertain_simulation_remark(numbers: VerdictNumbers) -> str:
    uncertain = (
        f"uncertain by up to {MM_PER_M * numbers.unresolved_m:.1f} mm at the tip"
    )
    if np.isinf(numbers.unresolved_m):
        uncertain = "uncertain, because it diverges on a finer mesh"
    return (
        f"Simulation is itself {uncertain}: gentler motion, or a string with more "
        "damping, would show more."
    )


def _probable_effects(numbers: VerdictNumbers) -> str:
    probable = []
    for name, probability in numbers.inclusion_probability.items():
        if probability > 0.5:
            probable.append(f"{readable_name(name)} ({probability:.2f})")
    return ", ".join(probable)


@dataclass(frozen=True)
class Judgement:
    """A verdict with the evidence for it.

    Attributes
    ----------
    numbers : VerdictNumbers
        The numbers that decided it.
    posteriors : tuple of SingleEffectPosterior
        Posteriors of the slot of each accepted cause.
    base_fit : Fit
        The base model's fit to the same data.
    background : Background
        Small amounts of other effects.
    interrupted : bool
        Whether the search was ended early.
    trial_clocks : dict or None
        Offset of the clocks of each trial, if trials differ in it.
    """

    verdict: Verdict
    numbers: VerdictNumbers
    posteriors: tuple[SingleEffectPosterior, ...]
    base_fit: Fit
    background: Background
    interrupted: bool = False
    trial_clocks: Mapping[str, Interval] | None = None

    @property
    def inclusion_probability(self) -> Mapping[str, float]:
        """Probability that each effect is active."""
        probabilities = self.numbers.inclusion_probability
        if self.verdict.causes == (RESOLUTION,):
            return {**probabilities, RESOLUTION: 1.0}
        return probabilities


def measure_verdict_numbers(
    posteriors: Posteriors,
    misfit: float,
    base_fit: Fit,
    criteria: Criteria,
    seed: int,
) -> VerdictNumbers:
    """Compute the numbers of the verdict, except those from left-out trials.

    Parameters
    ----------
    misfit : float
        Probability that the misfit of the model with causes exceeds the tolerance.
    """
    state = posteriors.state
    data = state.prepared.data
    fit = state.fit
    causes = fit.hypothesis.cause_names
    credible_sets = []
    for posterior in posteriors.by_cause:
        if posterior.holds_a_cause:
            credible = posterior.credible_set(criteria.coverage)
            credible_sets.append(tuple(filter(None, credible)))
    numbers = VerdictNumbers(
        trials=len(data.trials),
        causes=causes,
        credible_sets=tuple(credible_sets),
        inclusion_probability=inclusion_probabilities(posteriors.by_cause),
        diverged=fit.has_diverged,
        misfit_probability=misfit,
    )
    if numbers.diverged:
        return numbers

    unexplained_m = unexplained_tip_rms(data, fit)
    base_unexplained_m = unexplained_tip_rms(data, base_fit)
    explained = mean_explained_fraction(
        base_unexplained_m, unexplained_m, criteria.tip_tolerance_m
    )
    unresolved_m = unresolved_by_simulation(
        state.prepared.discretisation_uncertainty_m, base_unexplained_m, criteria
    )
    base_misfit = misfit
    if base_fit is not fit:
        base_misfit = misfit_probability(data, base_fit, criteria, seed)
    return replace(
        numbers,
        explained_fraction=explained,
        unresolved_m=unresolved_m,
        base_misfit_probability=base_misfit,
    )


def misfit_probability(
    data: TrialData,
    fit: Fit,
    criteria: Criteria,
    seed: int,
) -> float:
    """Estimate the probability that the misfit of a tip exceeds the tolerance.

    It is the share of draws of the discrepancy in which the root mean square of the
    worst trial's tip is larger.
    """
    # The same draws for all fits, so that probabilities differ only by the fits
    rng = np.random.default_rng([seed, DISCREPANCY_DRAWS])
    largest_m = sample_discrepancy_tip_rms(data, fit, rng).max(axis=0)
    return float(np.mean(largest_m > criteria.tip_tolerance_m))


def fit_base_to(state: SelectionState) -> Fit:
    """Fit the base model to the data of a state.

    The fit before the search may be in a poor local minimum, and its misfit would be
    attributed to a missing cause. So the parameters with the causes are a second start.
    """
    hypothesis = state.fit.hypothesis
    if not hypothesis.causes:
        return state.fit
    data = state.prepared.data
    base = Hypothesis(hypothesis.base)
    fits = [refit(data, start, base) for start in (state.prepared.base_fit, state.fit)]
    return max(fits, key=lambda fit: fit.log_evidence)


def judge_interrupted_search(
    state: SelectionState,
    effects: Sequence[type[Effect]],
    criteria: Criteria,
    seed: int,
) -> Judgement:
    """Report the causes that an interrupted search had found, without naming them."""
    data = state.prepared.data
    fit = state.fit
    background = find_background(data, fit, effects, criteria.tip_tolerance_m)
    weights = bootstrap_weights(len(data.trials), seed)
    step_of = {}
    for step in state.steps:
        if step.accepted and step.best is not None:
            step_of[step.best.hypothesis.cause_names[-1]] = step
    posteriors = list[SingleEffectPosterior]()
    for name in fit.hypothesis.cause_names:
        if name in step_of:
            posterior = single_effect_posterior(
                step_of[name],
                background,
                weights,
                len(effects),
                criteria,
            )
            posteriors.append(posterior)
    probability = misfit_probability(data, fit, criteria, seed)
    numbers = VerdictNumbers(
        trials=len(data.trials),
        causes=fit.hypothesis.cause_names,
        inclusion_probability=inclusion_probabilities(posteriors),
        misfit_probability=probability,
    )
    probable = _probable_effects(numbers) or "no cause"
    remark = f"The search was interrupted; so far it had found {probable}."
    verdict = Verdict("insufficient", probability, remark=remark)
    base_fit = fit_base_to(state)
    return Judgement(
        verdict,
        numbers,
        tuple(posteriors),
        base_fit,
        background,
        interrupted=True,
    )
