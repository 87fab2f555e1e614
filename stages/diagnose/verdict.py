"""What the data say of every effect: probabilities, look-alikes, and whether more is
left than is tolerated.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from stringcast.stages.diagnose.background_effects import (
    background_log_evidence_gains,
    background_responses,
)
from stringcast.stages.diagnose.forward_selection import (
    Criteria,
    SelectionState,
    SelectionStep,
    compare_candidates,
    mean_explained_fraction,
    refit,
    tip_shift_rms,
    unexplained_tip_rms,
)
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import (
    DISCREPANCY_DRAWS,
    Fit,
    evaluate_fit,
    fit_hypothesis,
    sample_discrepancy_tip_rms,
)
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.effect import Effect

RESOLUTION = "resolution"
# probability, before the data speak, that a simulation lacks nothing of the library
PRIOR_NO_EFFECT = 0.5
# of trials that might have been: probabilities are told to 0.05
BOOTSTRAP_SAMPLES = 100


@dataclass(frozen=True)
class SingleEffectPosterior:
    """One effect of the sum. chances: of each candidate, and of none (""), summing to
    one. fits: of those fitted. less: the fit with none.
    """

    probabilities: Mapping[str, float]
    fits: Mapping[str, Fit]
    fit_without: Fit

    def credible_set(self, coverage: float) -> tuple[str, ...]:
        """The fewest candidates that hold so much of the probability, the likeliest
        first.
        """
        ranked = sorted(self.probabilities, key=lambda name: -self.probabilities[name])
        held = np.cumsum([self.probabilities[name] for name in ranked])
        return tuple(ranked[: int(np.searchsorted(held, coverage * held[-1])) + 1])


@dataclass(frozen=True)
class Judgement:
    """verdict: as in diagnosis.json. causes: named, as they entered, and those that
    cannot be told from them. groups: of effects that cannot be told apart. inclusion:
    probability that each effect is at work. unknown: probability that more is left at
    the tip than is tolerated. base: the base model's fit to the same data. small: what
    other effects do, as of `responses`. sentence: what else there is to say.
    interrupted: not all was asked.
    """

    verdict: str
    causes: tuple[str, ...]
    lookalike_groups: tuple[tuple[str, ...], ...]
    inclusion_probability: Mapping[str, float]
    misfit_probability: float
    posteriors: tuple[SingleEffectPosterior, ...]
    base_fit: Fit
    background: Sequence[np.ndarray]
    remark: str = ""
    interrupted: bool = False

    @property
    def as_unknown(self) -> Judgement:
        """Without causes: what they explain they do not predict."""
        if not self.causes:
            return self
        said = "What explains these trials best does not predict those left out of its fit."
        return replace(
            self, verdict="unknown", causes=(), lookalike_groups=(), remark=said
        )


def swap_lookalikes_until_stable(
    found: SelectionState,
    effects: Sequence[type[Effect]],
    criteria: Criteria,
    too_few_points: bool,
    seed: int,
) -> tuple[SelectionState, Judgement]:
    """Where no cause is another's look-alike beyond doubt, every effect a little wrong,
    and what is said there. After so many changes as there are causes, the last is not
    asked anew. too_few_points: the configured mesh alone puts the tip elsewhere.
    """
    for changes in range(len(found.fit.hypothesis.causes), -1, -1):
        small, slots, other = (
            background_responses(found.prepared.data, found.fit, effects),
            list[SingleEffectPosterior](),
            None,
        )
        names = found.fit.hypothesis.cause_names
        for slot in _single_effect_posteriors(found, effects, small, criteria, seed):
            slots.append(slot)
            credible = slot.credible_set(criteria.coverage)
            # none, or another cause beyond doubt
            if names and (not credible[0] or not {*names} & {*credible}):
                other = other or slot.fits.get(credible[0], slot.fit_without)
            if changes and other is not None:
                break
        if other is None:
            break
        found = found.with_fit(other)
    end = _with_most_probable_causes(found, slots[::-1])
    if other is not None or end is not found:
        small = background_responses(end.prepared.data, end.fit, effects)
    return end, decide_verdict(end, small, slots[::-1], criteria, too_few_points, seed)


def _with_most_probable_causes(
    found: SelectionState, slots: Sequence[SingleEffectPosterior]
) -> SelectionState:
    """With what is likeliest in the place of each cause, if that is more evident
    together than what entered.
    """
    fits = [slot.fits.get(slot.credible_set(0.0)[0]) for slot in slots]
    likeliest = {fit.hypothesis.causes[-1]: fit for fit in fits if fit is not None}
    causes, data = found.fit.hypothesis.causes, found.prepared.data
    if len(likeliest) != len(causes) or likeliest.keys() == {*causes}:
        return found
    known = {
        name: chi
        for fit in (found.fit, *likeliest.values())
        for name, chi in fit.exponents.items()
    }
    together = Hypothesis(found.fit.hypothesis.base, tuple(likeliest))
    fit = fit_hypothesis(
        data, together, together.exponents_from(known)[None], found.fit.scale_indices
    )
    return max(found, found.with_fit(fit), key=lambda each: each.fit.log_evidence)


def judge_interrupted_search(
    found: SelectionState,
    effects: Sequence[type[Effect]],
    criteria: Criteria,
    seed: int,
) -> Judgement:
    """What a search that was interrupted knows: it names nothing before all was asked."""
    data, fit = found.prepared.data, found.fit
    small, often = (
        background_responses(data, fit, effects),
        _bootstrap_weights(len(data.trials), seed),
    )
    last = {
        step.best.hypothesis.cause_names[-1]: step
        for step in found.steps
        if step.accepted and step.best is not None
    }
    # of what has not left again
    steps = (last[name] for name in fit.hypothesis.cause_names if name in last)
    slots = tuple(
        _single_effect_posterior(
            data, step, small, often, len(effects), criteria.least_size
        )
        for step in steps
    )
    unnamed = _judgement_without_causes(found, small, slots, criteria, seed)
    likely = [
        f"{name} ({chance:.2f})"
        for name, chance in unnamed.inclusion_probability.items()
        if chance > PRIOR_NO_EFFECT
    ]
    said = f"The search for causes was interrupted, when it had come to {', '.join(likely) or 'none'}."
    return replace(unnamed, verdict="insufficient", remark=said, interrupted=True)


def _judgement_without_causes(
    found: SelectionState,
    small: Sequence[np.ndarray],
    slots: Sequence[SingleEffectPosterior],
    criteria: Criteria,
    seed: int,
) -> Judgement:
    """Of the causes that entered, before any is named: `none`, or `unknown` where too
    much is left beside them.
    """
    data, fit = found.prepared.data, found.fit
    base = (
        refit(data, found.prepared.base_fit, Hypothesis(fit.hypothesis.base))
        if fit.hypothesis.causes
        else fit
    )
    return _with_misfit_probability(
        Judgement(
            "none",
            (),
            (),
            _inclusion_probabilities(slots),
            0.0,
            tuple(slots),
            base,
            small,
        ),
        data,
        fit,
        criteria,
        seed,
    )


def _with_misfit_probability(
    unnamed: Judgement, data: TrialData, fit: Fit, criteria: Criteria, seed: int
) -> Judgement:
    """The same by what a fit leaves."""
    unknown = misfit_probability(
        data, fit, criteria, np.random.default_rng([seed, DISCREPANCY_DRAWS])
    )
    return replace(
        unnamed,
        misfit_probability=unknown,
        verdict="unknown" if unknown > 0.5 else "none",
    )


def decide_verdict(
    found: SelectionState,
    small: Sequence[np.ndarray],
    slots: Sequence[SingleEffectPosterior],
    criteria: Criteria,
    too_few_points: bool,
    seed: int,
) -> Judgement:
    """The verdict on the causes that entered, one for each slot. small: as of
    `responses`.
    """
    data, fit, unnamed = (
        found.prepared.data,
        found.fit,
        _judgement_without_causes(found, small, slots, criteria, seed),
    )
    if fit.diverged:
        said = "A trial cannot be simulated with the parameters that suit the others."
        return replace(unnamed, verdict="insufficient", remark=said)
    left = unexplained_tip_rms(data, fit)
    together = mean_explained_fraction(
        unexplained_tip_rms(data, unnamed.base_fit), left, criteria.tolerance
    )
    least, largest, beside = criteria.least_share, "", 1.0
    if unnamed.verdict == "unknown":
        least, (largest, beside) = (
            criteria.explained,
            _explained_beyond_largest_cause(data, fit, left, criteria),
        )
    if not fit.hypothesis.causes or together < least or beside < criteria.least_share:
        unnamed = (
            unnamed
            if unnamed.base_fit is fit
            else _with_misfit_probability(
                unnamed, data, unnamed.base_fit, criteria, seed
            )
        )
        if unnamed.verdict == "none" and too_few_points:
            known = {**unnamed.inclusion_probability, RESOLUTION: 1.0}
            return replace(
                unnamed,
                verdict="effect",
                causes=(RESOLUTION,),
                inclusion_probability=known,
            )
        nearest = _closest_explanation(fit, together, largest, beside)
        return replace(unnamed, remark=nearest if unnamed.verdict == "unknown" else "")
    groups = tuple(
        g for g in (_lookalike_group(s, criteria) for s in slots) if len(g) > 1
    )
    causes = tuple(
        dict.fromkeys(
            name for slot in slots for name in _lookalike_group(slot, criteria)
        )
    )
    return replace(
        unnamed,
        verdict="ambiguous" if groups else "effect",
        causes=causes,
        lookalike_groups=groups,
    )


def _explained_beyond_largest_cause(
    data: TrialData, fit: Fit, left: np.ndarray, criteria: Criteria
) -> tuple[str, float]:
    """The cause without which most is lacking, and the share of what it alone leaves
    that the others remove: a large cause shall not carry what stands in for one that
    nobody knows. All of it where there are no others. left: what all of them leave in
    each trial [m], (K,).
    """
    causes = fit.hypothesis.causes
    if len(causes) < 2:
        return "", 1.0
    without = [
        refit(data, fit, fit.hypothesis.without_cause(cause)) for cause in causes
    ]
    number = int(
        np.argmax([np.mean(unexplained_tip_rms(data, less) ** 2) for less in without])
    )
    largest = causes[number]
    if len(causes) == 2:  # without the other
        alone = without[1 - number]
    else:
        alone = refit(data, fit, Hypothesis(fit.hypothesis.base, (largest,)))
    return largest.name, mean_explained_fraction(
        unexplained_tip_rms(data, alone), left, criteria.tolerance
    )


def _closest_explanation(fit: Fit, together: float, largest: str, beside: float) -> str:
    """What comes nearest to an explanation, if anything does. together, beside: shares
    that the causes remove of what is lacking without them all, and with the largest
    alone.
    """
    names = fit.hypothesis.cause_names
    if not names or together < 0:
        return ""
    said = f"What comes nearest, {' with '.join(names)}, removes {100 * together:.0f} % of it in mean square"
    if largest:
        others = " with ".join(name for name in names if name != largest)
        said += f", {others} {100 * max(beside, 0):.0f} % of what {largest} leaves"
    return f"{said}."


def misfit_probability(
    data: TrialData, fit: Fit, criteria: Criteria, rng: np.random.Generator
) -> float:
    """Probability that in some trial more is lacking at the tip than is tolerated, root
    mean square.
    """
    return float(
        np.mean(
            sample_discrepancy_tip_rms(data, fit, rng).max(axis=0) > criteria.tolerance
        )
    )


def _compare_alternatives(
    found: SelectionState,
    cause: type[Effect],
    effects: Sequence[type[Effect]],
    criteria: Criteria,
    seed: int,
) -> SelectionStep:
    """What else could be in the place of a cause, the others staying."""
    first = found.steps[0]
    if (
        first.best is not None
        and first.best.hypothesis.cause_names == found.fit.hypothesis.cause_names
    ):
        return first
    data, less = found.prepared.data, found.fit.hypothesis.without_cause(cause)
    itself = less.with_cause(cause)
    named = evaluate_fit(data, itself, itself.exponents_from(found.fit.exponents))
    return compare_candidates(
        found.prepared, refit(data, found.fit, less), effects, criteria, seed, named
    )


def _single_effect_posteriors(
    found: SelectionState,
    effects: Sequence[type[Effect]],
    small: Sequence[np.ndarray],
    criteria: Criteria,
    seed: int,
) -> Iterator[SingleEffectPosterior]:
    """Of each cause, the last that entered first: it is most often another's
    look-alike. Of what might yet enter where none did.
    """
    data, causes = found.prepared.data, reversed(found.fit.hypothesis.causes)
    often = _bootstrap_weights(len(data.trials), seed)
    steps = (
        _compare_alternatives(found, cause, effects, criteria, seed) for cause in causes
    )
    for step in steps if found.fit.hypothesis.causes else found.steps[-1:]:
        yield _single_effect_posterior(
            data, step, small, often, len(effects), criteria.least_size
        )


def _bootstrap_weights(trials: int, seed: int) -> np.ndarray:
    """How often each trial counts in samples of those that might have been, (SAMPLES,
    K) (Bayesian bootstrap).
    """
    return trials * np.random.default_rng([seed, BOOTSTRAP_SAMPLES]).dirichlet(
        np.ones(trials), BOOTSTRAP_SAMPLES
    )


def _single_effect_posterior(
    data: TrialData,
    step: SelectionStep,
    small: Sequence[np.ndarray],
    often: np.ndarray,
    count: int,
    least_size: float,
) -> SingleEffectPosterior:
    """Chances of what may be in one place of the sum, with all effects a little wrong,
    and trials that are a sample of those that might have been: each as often (D, K) as
    a Bayesian bootstrap has it (pseudo-BMA+: Yao et al. 2018, Bayesian Analysis 13,
    917). Those fitted to the end alone, if any are. count: of candidates. least_size:
    [m] at the tip, below which an effect counts as none.
    """
    fits = {
        fit.hypothesis.cause_names[-1]: fit
        for fit in step.refined or step.fits
        if not fit.diverged
    }
    prior = dict.fromkeys(fits, np.log((1 - PRIOR_NO_EFFECT) / count)) | {
        "": np.log(PRIOR_NO_EFFECT)
    }
    odds: dict[str, np.ndarray] = {
        name: fit.log_evidence
        + (often - 1) @ fit.log_likelihood_by_trial
        + background_log_evidence_gains(data, fit, small, often)
        + prior[name]
        for name, fit in {"": step.parent, **fits}.items()
    }
    total = logsumexp(list(odds.values()), axis=0)
    chances = {
        name: float(np.mean(np.exp(value - total))) for name, value in odds.items()
    }
    for name, fit in fits.items():
        if tip_shift_rms(data, step.parent, fit).max() < least_size:
            chances[""] += chances.pop(name)
    return SingleEffectPosterior(chances, fits, step.parent)


def _inclusion_probabilities(
    slots: Sequence[SingleEffectPosterior],
) -> dict[str, float]:
    """Probability that each effect is in one place of the sum or another."""
    absent: dict[str, float] = {}
    for slot in slots:
        for name, chance in slot.probabilities.items():
            if name:
                absent[name] = absent.get(name, 1.0) * (1 - chance)
    return {name: 1 - share for name, share in absent.items()}


def _lookalike_group(
    slot: SingleEffectPosterior, criteria: Criteria
) -> tuple[str, ...]:
    return tuple(name for name in slot.credible_set(criteria.coverage) if name)
