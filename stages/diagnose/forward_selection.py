"""The search: one single effect after another, each chosen by its evidence beside those
already at work.

A sum of single effects (SuSiE) is forward choice done as Bayes: for every effect in the
sum all candidates compete, none among them, and what cannot be told from the winner
stays beside it. An effect enters that has evidence whichever trial is left out of it
(jackknife), and moves the tip; what entered earlier leaves again if what came later
does without, and what does not help to predict trials left out.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated

import numpy as np
from pydantic import Field

from stringcast.stages.diagnose.predictions import (
    Prediction,
    log_likelihood_gains,
    predict_trials,
)
from stringcast.stages.diagnose.prepared_data import (
    MIN_RESOLVED_TRIALS,
    NEGLIGIBLE_LOG_EVIDENCE,
    STRONG_LOG_EVIDENCE,
    PreparedData,
    correct_discretisation_once,
    refit_from_new_starts,
)
from stringcast.stages.diagnose.proposals import (
    Proposal,
    alternative_parameter_starts,
    propose_causes,
)
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import (
    Fit,
    evaluate_fit,
    fit_hypothesis,
    mean_discrepancy,
)
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.effect import (
    Effect,
    amplitude_parameters,
    is_position_dependent,
)

log = logging.getLogger(__name__)

# proposals fitted first; the others, if none of these explains what is left
INITIAL_PROPOSALS = 6
MAX_RIVALS = 3  # fitted to the end, at most

Fraction = Annotated[float, Field(gt=0, lt=1)]
Metres = Annotated[float, Field(gt=0, lt=0.1)]


@dataclass(frozen=True)
class Criteria:
    """The seven numbers that decide. causes: at most. coverage: of credible sets and
    intervals. alpha: an effect enters with a Bayes factor of more than one over it.
    tolerance: [m] at the tip that may be left unexplained. least_size: [m] by which a
    cause must move the tip. least_share: of what is unexplained that the causes must
    remove; where they leave more than is tolerated, all but the largest of what that
    leaves. explained: the same there of all together.
    """

    causes: Annotated[int, Field(ge=1, le=8)]
    coverage: Fraction
    alpha: Fraction
    tolerance: Metres
    least_size: Metres
    least_share: Fraction
    explained: Fraction

    @property
    def min_log_bayes_factor(self) -> float:
        """Logarithm of the Bayes factor from which an effect enters."""
        return float(-np.log(self.alpha))


@dataclass(frozen=True)
class SelectionStep:
    """One choice. parent: the fit beside which it is made. proposals: of all
    candidates. tried: those fitted, the most evident first. to_the_end: those of them
    that came near to the most evident, and were fitted to the end. entered: whether the
    best of them is there beyond doubt.
    """

    parent: Fit
    proposals: Sequence[Proposal]
    fits: Sequence[Fit]
    refined: Sequence[Fit] = ()
    accepted: bool = False

    @property
    def best(self) -> Fit | None:
        """The most evident."""
        return self.fits[0] if self.fits else None

    def refit_to(self, data: TrialData) -> SelectionStep:
        """The same of data with other points: those fitted to the end are so anew."""
        parent, *ended = (
            refit(data, fit, fit.hypothesis) for fit in (self.parent, *self.refined)
        )
        others = [
            fit for fit in self.fits if not any(fit is other for other in self.refined)
        ]
        tried = _by_evidence(
            [*ended, *(evaluate_fit(data, fit.hypothesis, fit.chi) for fit in others)]
        )
        return replace(self, parent=parent, fits=tried, refined=ended)


@dataclass(frozen=True)
class SelectionState:
    """Where a search ended. prepared: data about the last fit. fit: with all causes.
    path: what was chosen on the way, the last step being that which chose none.
    """

    prepared: PreparedData
    fit: Fit
    steps: Sequence[SelectionStep] = ()

    def with_fit(self, fit: Fit) -> SelectionState:
        """With another fit, gone to its end."""
        return SelectionState(*refine_fit(self.prepared, fit), self.steps)

    @cached_property
    def predictions(self) -> list[Prediction]:
        """Each trial by the fit to the others."""
        return predict_trials(self.prepared.data, self.fit)


def select_causes(
    prepared: PreparedData,
    effects: Sequence[type[Effect]],
    criteria: Criteria,
    seed: int,
    starts: int,
) -> Iterator[SelectionState]:
    """With each of the causes that enter, one after another; in the end without those
    that do not help.
    """
    found = SelectionState(prepared, prepared.base_fit)
    for number in range(criteria.causes):
        step = compare_candidates(found.prepared, found.fit, effects, criteria, seed)
        found = replace(found, steps=(*found.steps, step))
        if step.best is None or not step.accepted:
            break
        found = add_cause(
            found, step.best, criteria, np.random.default_rng([seed, number]), starts
        )
        log.info(
            "enters: %s, evidence %+.1f",
            step.best.hypothesis.cause_names[-1],
            step.best.log_evidence - step.parent.log_evidence,
        )
        yield found
    yield drop_unpredictive_causes(found, criteria)


def drop_unpredictive_causes(
    found: SelectionState, criteria: Criteria
) -> SelectionState:
    """Without causes that do not help to predict trials left out, the last that entered
    first.

    The log-likelihood of what was not seen must rise (cross-validation by trials:
    Vehtari, Gelman and Gabry 2017, Stat. Comput. 27, 1413), in the median trial: one
    that is foretold badly, such as a chaotic one 150 mm off by the right cause, would
    outvote all others. Of what acts in one trial alone no other trial can tell.
    """
    if len(found.prepared.data.trials) < 2:
        return found
    for cause in reversed(found.fit.hypothesis.causes):
        data = found.prepared.data
        if len(_trials_touched_by(data, found.fit, cause, criteria.least_size)) == 1:
            continue
        less = replace(
            found, fit=refit(data, found.fit, found.fit.hypothesis.without_cause(cause))
        )
        gains = log_likelihood_gains(less.predictions, found.predictions)
        log.info(
            "without %s trials left out are %s likelier",
            cause.name,
            np.round(-gains, 1),
        )
        if np.median(gains) <= 0:
            log.info(
                "%s leaves: it does not help to predict trials left out", cause.name
            )
            found = found.with_fit(less.fit)
    return found


def compare_candidates(
    prepared: PreparedData,
    parent: Fit,
    effects: Sequence[type[Effect]],
    criteria: Criteria,
    seed: int,
    at_its_end: Fit | None = None,
) -> SelectionStep:
    """Every effect beside those of a fit, the promising ones fitted, and those like the
    best of them; all of them where something is to be explained and none of these does.
    Those that come near to the most evident are fitted to the end: little tells
    look-alikes. at_its_end: the fit of one of them, where that is known.
    """
    data, known = prepared.data, [] if at_its_end is None else [at_its_end]
    ranked = propose_causes(
        data, parent, [e for e in effects if e not in parent.hypothesis.causes], seed
    )
    rest = [
        p for p in ranked if not any(p.effect in fit.hypothesis.causes for fit in known)
    ]
    first = [p for p in rest[:INITIAL_PROPOSALS] if p.gain > STRONG_LOG_EVIDENCE]
    step = SelectionStep(
        parent, ranked, _by_evidence([*known, *_fit_proposals(prepared, parent, first)])
    )
    alike = _lookalikes_of_best(step, [p for p in rest if p not in first], criteria)
    step = replace(
        step, fits=_by_evidence([*step.fits, *_fit_proposals(prepared, parent, alike)])
    )
    step = _refine_top_rivals(prepared, step, criteria, at_its_end)
    if (
        not step.accepted
        and unexplained_tip_rms(data, parent).max() > criteria.least_size
    ):
        others = [p for p in rest if p not in first and p not in alike]
        step = replace(
            step,
            fits=_by_evidence([*step.fits, *_fit_proposals(prepared, parent, others)]),
        )
        step = _refine_top_rivals(prepared, step, criteria, at_its_end)
    return step


def _lookalikes_of_best(
    step: SelectionStep, others: Sequence[Proposal], criteria: Criteria
) -> list[Proposal]:
    """Those of other proposals that could explain the least share of what the best
    does, to first order: promises may rank a look-alike lower.
    """
    if (
        step.best is None
        or step.best.log_evidence
        < step.parent.log_evidence + criteria.min_log_bayes_factor
    ):
        return []
    best = [p for p in step.proposals if p.effect is step.best.hypothesis.causes[-1]]
    return [
        p
        for p in others
        if any(p.cosine_similarity(each) ** 2 > criteria.least_share for each in best)
    ]


def _refine_top_rivals(
    prepared: PreparedData,
    step: SelectionStep,
    criteria: Criteria,
    at_its_end: Fit | None = None,
) -> SelectionStep:
    """With those fitted to the end that come near to the most evident, if that is
    evident at all, and whether the best then enters. Without one by which simulation
    tells fewer than two trials, or, in the place of a cause that is there, not all of
    them: what is in doubt in the others may explain anything.
    """
    parent = step.parent
    if (
        step.best is None
        or step.best.log_evidence < parent.log_evidence + criteria.min_log_bayes_factor
    ):
        return step
    near = parent.log_evidence + criteria.least_share * (
        step.best.log_evidence - parent.log_evidence
    )
    count = sum(fit.log_evidence > near for fit in step.fits[:MAX_RIVALS])
    rivals = [
        (prepared, fit) if fit is at_its_end else refine_fit(prepared, fit)
        for fit in step.fits[:count]
    ]
    enough, least = (
        len(prepared.discretisation_uncertainty_m),
        np.zeros(len(prepared.discretisation_uncertainty_m)),
    )
    if at_its_end is None:
        enough, least = (
            min(MIN_RESOLVED_TRIALS, enough),
            np.sqrt(1 - criteria.explained)
            * unexplained_tip_rms(prepared.data, parent),
        )
    told = [
        fit
        for made, fit in rivals
        if _count_resolved_trials(made, prepared, criteria, least) >= enough
    ]
    step = replace(step, fits=_by_evidence([*told, *step.fits[count:]]), refined=told)
    return replace(
        step,
        accepted=step.best is not None and is_supported(prepared.data, step, criteria),
    )


def _count_resolved_trials(
    made: PreparedData,
    before: PreparedData,
    criteria: Criteria,
    least: np.ndarray | float = 0.0,
) -> int:
    """How many trials simulation tells to the tolerance, or as well as the worst of
    them before, or to what may be left of what is to be explained in each [m], (K,).
    """
    return int(
        (
            made.discretisation_uncertainty_m
            <= np.maximum(
                max(before.discretisation_uncertainty_m.max(), criteria.tolerance),
                least,
            )
        ).sum()
    )


def is_supported(data: TrialData, step: SelectionStep, criteria: Criteria) -> bool:
    """Whether the best of a step is there beyond doubt: without any one trial, and
    large enough to matter.

    What touches the string in one trial alone, all the others cannot say: it must
    explain that one.
    """
    best = step.best
    assert best is not None
    gain = best.log_evidence - step.parent.log_evidence
    if (
        gain < criteria.min_log_bayes_factor
        or best.diverged
        or tip_shift_rms(data, step.parent, best).max() < criteria.least_size
    ):
        return False
    touched = _trials_touched_by(
        data, best, best.hypothesis.causes[-1], criteria.least_size
    )
    if len(touched) == 1:
        parts = explained_fractions(
            unexplained_tip_rms(data, step.parent), unexplained_tip_rms(data, best)
        )
        return bool(parts[touched[0]] > criteria.least_share)
    # which nothing could confirm: it is only said what would be asked of more trials
    if len(data.trials) == 1:
        return True
    return (
        min_leave_one_out_gain(step.parent, best) > criteria.min_log_bayes_factor
        or _jackknife_gain(data, step) > criteria.min_log_bayes_factor
        or _cross_validated_gain(data, step) > criteria.min_log_bayes_factor
    )


def min_leave_one_out_gain(parent: Fit, fit: Fit) -> float:
    """Gain of the evidence, whichever trial is left out, both fits staying where they
    are.
    """
    return float(
        fit.log_evidence
        - parent.log_evidence
        - (fit.log_likelihood_by_trial - parent.log_likelihood_by_trial).max()
    )


def _jackknife_gain(data: TrialData, step: SelectionStep) -> float:
    """Gain of the evidence without the trial that says most for the best of a step,
    fitted anew to the others: that one may have taken the fit along.
    """
    best = step.best
    assert best is not None
    most = int(
        np.argmax(best.log_likelihood_by_trial - step.parent.log_likelihood_by_trial)
    )
    rest = [k for k in range(len(data.trials)) if k != most]
    if not rest:
        return -np.inf
    fits = (best, step.parent)
    others = [
        fit_hypothesis(
            data.subset(rest), f.hypothesis, f.chi[None], f.scale_indices[rest]
        )
        for f in fits
    ]
    return others[0].log_evidence - others[1].log_evidence


def _cross_validated_gain(data: TrialData, step: SelectionStep) -> float:
    """Gain of the log-likelihood of trials, each foretold by the fit to the others, but
    for the one that gains most: a parent may explain one trial at the cost of another,
    which alone then speaks for what explains both.
    """
    assert step.best is not None
    gains = log_likelihood_gains(
        predict_trials(data, step.parent), predict_trials(data, step.best)
    )
    return float(gains.sum() - gains.max())


def _trials_touched_by(
    data: TrialData, fit: Fit, cause: type[Effect], least_size: float
) -> np.ndarray:
    """Numbers of the trials in which a cause of a fit that depends on place moves the
    tip by that much [m].
    """
    if not is_position_dependent(cause):
        return np.zeros(0, dtype=int)
    sizes = {
        cause.qualified_name(parameter) for parameter in amplitude_parameters(cause)
    }
    absent = fit.hypothesis.exponents_from(
        {name: chi for name, chi in fit.exponents.items() if name not in sizes}
    )
    others = [each[0] for each in data.residuals(fit.hypothesis.model, absent[None])]
    acts = data.tip_rms_by_trial(
        [a - b for a, b in zip(fit.residuals, others, strict=True)]
    )
    return np.flatnonzero(acts > least_size)


def unexplained_tip_rms(data: TrialData, fit: Fit) -> np.ndarray:
    """Root mean square at the tip of what a fit most likely lacks in each trial [m],
    (K,).
    """
    return data.tip_rms_by_trial(mean_discrepancy(data, fit))


def mean_explained_fraction(
    before: np.ndarray, after: np.ndarray, tolerance: float
) -> float:
    """Share of what one fit lacks in each trial [m], (K,), as of `unexplained`, that
    another does not: the mean of the trials in which either lacks more than is
    tolerated [m], one vote each, for one that is far off says nothing of the others,
    nor do they of it.
    """
    lacking = np.maximum(before, after)
    return float(
        explained_fractions(before, after)[
            lacking >= min(tolerance, lacking.max())
        ].mean()
    )


def explained_fractions(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """By how much less a fit lacks in each trial than another [m], (K,) each, in mean
    square at the tip, over the larger of both, (K,): 1 where it lacks nothing, -1 where
    the other does not.
    """
    before, after = before**2, after**2
    return np.asarray(
        (before - after) / np.maximum(np.maximum(before, after), np.finfo(float).tiny)
    )


def tip_shift_rms(data: TrialData, one: Fit, other: Fit) -> np.ndarray:
    """Root mean square by which two fits differ at the tip of each trial [m], (K,)."""
    return data.tip_rms_by_trial(
        [a - b for a, b in zip(one.residuals, other.residuals, strict=True)]
    )


def refine_fit(prepared: PreparedData, fit: Fit) -> tuple[PreparedData, Fit]:
    """Data with the numerical error of a fit, and the fit to these: with other values
    of its causes' parameters, if these suit better.
    """
    log.info("to the end: %s", " + ".join(fit.hypothesis.cause_names))
    prepared, fit = correct_discretisation_once(prepared, fit)
    others = alternative_parameter_starts(prepared.data, fit)
    if not len(others):
        return prepared, fit
    other = fit_hypothesis(prepared.data, fit.hypothesis, others, fit.scale_indices)
    return (
        correct_discretisation_once(prepared, other)
        if other.log_evidence > fit.log_evidence
        else (prepared, fit)
    )


def add_cause(
    found: SelectionState,
    best: Fit,
    criteria: Criteria,
    rng: np.random.Generator,
    starts: int,
) -> SelectionState:
    """With one more cause, numerical error as it is there, and without causes that are
    not needed any more. Other strings are no better whose trials cannot be simulated as
    well: what is in doubt of these may explain anything.
    """
    heard = found.prepared.with_reestimated_noise(best)
    prepared, fit = correct_discretisation_once(heard, best)
    if heard.point_counts != found.prepared.point_counts:
        log.info(
            "%d outliers instead of %d",
            heard.outlier_count,
            found.prepared.outlier_count,
        )
        found = replace(
            found, steps=[step.refit_to(prepared.data) for step in found.steps]
        )
    if unexplained_tip_rms(prepared.data, fit).max() > criteria.least_size:
        again = refine_fit(
            prepared, refit_from_new_starts(prepared.data, fit, rng, starts)
        )
        if again[1].log_evidence > fit.log_evidence and _count_resolved_trials(
            again[0], prepared, criteria
        ) == len(prepared.discretisation_uncertainty_m):
            prepared, fit = again
    joined = SelectionState(prepared, fit, found.steps)
    # the new one, too: where it led, the others may do without it
    for cause in best.hypothesis.causes:
        less = refit(
            joined.prepared.data, joined.fit, joined.fit.hypothesis.without_cause(cause)
        )
        if less.log_evidence > joined.fit.log_evidence - criteria.min_log_bayes_factor:
            log.info("%s leaves: it is not needed", cause.name)
            joined = joined.with_fit(less)
    return joined


def refit(data: TrialData, fit: Fit, hypothesis: Hypothesis) -> Fit:
    """Another hypothesis at its best, from where a fit is."""
    return fit_hypothesis(
        data,
        hypothesis,
        hypothesis.exponents_from(fit.exponents)[None],
        fit.scale_indices,
    )


def _fit_proposals(
    prepared: PreparedData, parent: Fit, some: Sequence[Proposal]
) -> list[Fit]:
    """Proposals fitted, those that gain with their own numerical error: a strip in a
    clamp gained 128 without that, and 637 with.
    """
    fits: list[Fit] = []
    for number, proposal in enumerate(some, 1):
        best = (
            max((fit.log_evidence for fit in fits), default=parent.log_evidence)
            - parent.log_evidence
        )
        log.info(
            "%d of %d: %s, best %+.1f", number, len(some), proposal.effect.name, best
        )
        fit = fit_hypothesis(
            prepared.data,
            proposal.hypothesis,
            proposal.starts,
            parent.scale_indices,
            NEGLIGIBLE_LOG_EVIDENCE,
        )
        first = fit.log_evidence - parent.log_evidence
        if first > 0:
            fit = fit_hypothesis(
                prepared.one_mesh_corrected_data(fit),
                fit.hypothesis,
                fit.chi[None],
                fit.scale_indices,
                NEGLIGIBLE_LOG_EVIDENCE,
            )
        gains = (fit.log_evidence - parent.log_evidence, first, proposal.gain)
        log.info(
            "%s: evidence %+.1f, at first %+.1f, promised %.1f",
            proposal.effect.name,
            *gains,
        )
        fits.append(fit)
    return _by_evidence(fits)


def _by_evidence(fits: Sequence[Fit]) -> list[Fit]:
    return sorted(fits, key=lambda fit: -fit.log_evidence)
