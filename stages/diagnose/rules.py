"""The rules that decide whether a cause is accepted and what the verdict is.

A **candidate** is compared with the fit without it (its parent). A candidate at the end
of its range ranks below rivals inside their ranges that explain at least
`min_explained_fraction` of what it does:

=========================  =========================================================
rule                       passes if
=========================  =========================================================
`is_resolved`              simulation with it resolves at least two trials, or all
                           trials if it would replace an accepted cause; if not, it
                           can only be indistinguishable from the best
`has_evidence`             its Bayes factor is at least 1/alpha
`is_large_enough`          it moves the tip of a trial by `tip_tolerance_m`, or brings
                           the misfit from above that to below
`explains_its_only_trial`  it touches the string in a single trial, and removes
                           `min_explained_fraction` of the misfit there
`survives_leave_one_out`   its Bayes factor exceeds 1/alpha without the trial that
                           supports it most (fits kept, refitted, or cross-validated)
=========================  =========================================================

An **accepted cause** stays while later causes are added:

=========================  =========================================================
`is_needed`                without it the Bayes factor drops by more than 1/alpha
`predicts_heldout`         in predictions of each trial from the others, it raises
                           the likelihood of the median trial and brings tips closer
`is_inside_range`          none of its amplitudes is at an end of its range or below
                           its least meaningful size
`trials_agree`             if misfit remains, its probability from the scatter of
                           leave-one-out fits is above one half (three trials or more)
=========================  =========================================================

The **verdict** names the accepted causes only if all of these pass:

=========================  =========================================================
`can_be_simulated`         no trial diverges with the fitted parameters
`can_be_confirmed`         there is a second trial
`explains_enough`          the causes remove `min_explained_fraction` of the misfit;
                           if misfit remains, they make it smaller
`predicts_better`          the extended model predicts held-out trials better; if
                           misfit remains, their tips are closer
=========================  =========================================================

If misfit remains, the verdict on the named causes is `partial`. Their probability then
depends on two things: whether their effect is the same in all trials (`trials_agree`),
and whether they leave little where the model holds (`stand_ins`).
"Misfit remains" (`misfit_remains`) if the unexplained displacement of some trial's tip
exceeds `tip_tolerance_m` with a probability above one half.
Simulation can agree with trials only if it resolves two of them, or the only one
(`agreement_is_resolved`). If it does not, no cause is suggested from a single trial.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from pydantic import Field

from stringcast.stages.diagnose.evidence.measures import (
    cross_validated_gain,
    explained_fractions,
    fixed_leave_one_out_gain,
    refitted_leave_one_out_gain,
    tip_shift_rms,
    trials_touched_by,
    unexplained_tip_rms,
)
from stringcast.stages.inference.laplace import ABSENCE_TOLERANCE, Fit
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.effect import Effect, amplitude_parameters

STRONG_LOG_EVIDENCE = 5.0  # by Jeffreys' scale
NEGLIGIBLE_LOG_EVIDENCE = 1.0  # "not worth more than a bare mention" on that scale
MIN_RESOLVED_TRIALS = 2  # one to find a cause and one to confirm it
UNRESOLVED_FRACTION = 0.1  # of a trial's mean square misfit that may stay unresolved

Fraction = Annotated[float, Field(gt=0, lt=1)]
Metres = Annotated[float, Field(gt=0, lt=0.1)]


@dataclass(frozen=True)
class Criteria:
    """The thresholds of the rules.

    Attributes
    ----------
    coverage : float
        Probability of credible sets and of intervals.
    alpha : float
        A cause is accepted with a Bayes factor of at least its inverse.
    tip_tolerance_m : float
        Tolerance at the tip [m]: a larger misfit must be explained, a cause that moves
        the tip less is too small to report, and simulations must be this accurate.
    min_explained_fraction : float
        Fraction of the mean square misfit that causes must remove.
    """

    max_causes: Annotated[int, Field(ge=1, le=8)]
    coverage: Fraction
    alpha: Fraction
    tip_tolerance_m: Metres
    min_explained_fraction: Fraction

    @property
    def min_log_bayes_factor(self) -> float:
        """Logarithm of the least Bayes factor of an accepted cause."""
        return float(-np.log(self.alpha))

    @property
    def deciding_log_odds(self) -> float:
        """Least log odds at which one of two hypotheses alone is the credible set."""
        return float(np.log(self.coverage / (1 - self.coverage)))


@dataclass(frozen=True)
class VerdictNumbers:
    """The numbers on which the verdict depends.

    Attributes
    ----------
    trials : int
        Number of trials in which causes were searched.
    causes : tuple of str
        Causes that were accepted.
    credible_sets : tuple of tuple of str
        For each slot that probably has a cause, the effects that explain the trials
        about equally well.
    inclusion_probability : dict
        Probability that each effect is active.
    diverged : bool
        Whether the simulation of a trial diverges with the fitted parameters.
    misfit_probability, base_misfit_probability : float
        Probability that the misfit of the extended or the base model exceeds the
        tolerance.
    explained_fraction : float
        Fraction of the base model's mean square misfit that all causes remove.
    mesh_too_coarse : bool
        Whether the configured mesh alone displaces the tip by more than the tolerance.
    heldout_is_closer : bool
        Whether the extended model predicts held-out trials better.
    heldout_explained_fraction : float
        Fraction of the base model's misfit in these trials that it removes.
    unresolved_m : float
        Numerical uncertainty at the tip if simulation resolves too few trials [m], else
        0.
    """

    trials: int
    causes: tuple[str, ...] = ()
    credible_sets: tuple[tuple[str, ...], ...] = ()
    inclusion_probability: Mapping[str, float] = field(default_factory=dict)
    diverged: bool = False
    misfit_probability: float = 0.0
    base_misfit_probability: float = 0.0
    explained_fraction: float = 1.0
    mesh_too_coarse: bool = False
    heldout_is_closer: bool = True
    heldout_explained_fraction: float = 1.0
    unresolved_m: float = 0.0


def is_resolved(
    uncertainty_m: np.ndarray,
    before_m: np.ndarray,
    criteria: Criteria,
    needed: int,
    misfit_allowance_m: np.ndarray | float = 0.0,
) -> bool:
    """Whether simulation resolves enough trials once a candidate is fitted.

    Parameters
    ----------
    uncertainty_m, before_m : numpy.ndarray, shape (K,)
        Uncertainty of the discretisation error at each tip with the candidate and
        without [m]. A trial is resolved if it is at most the tolerance, the largest
        uncertainty without the candidate, or `misfit_allowance_m`.
    needed : int
        Number of trials that must be resolved.
    misfit_allowance_m : numpy.ndarray, shape (K,)
        Misfit of each trial that may remain anyway [m].
    """
    allowed = max(before_m.max(), criteria.tip_tolerance_m)
    allowed = np.maximum(allowed, misfit_allowance_m)
    resolved = (uncertainty_m <= allowed).sum()
    return bool(resolved >= needed)


def has_evidence(parent: Fit, fit: Fit, criteria: Criteria) -> bool:
    """Whether the Bayes factor of a fit over its parent is at least 1/alpha."""
    return fit.log_evidence - parent.log_evidence >= criteria.min_log_bayes_factor


def is_large_enough(
    data: TrialData,
    parent: Fit,
    fit: Fit,
    criteria: Criteria,
) -> bool:
    """Whether the last cause of a fit is worth reporting.

    It moves the tip of a trial by the tolerance, or it moves it by less and thereby
    brings a misfit above the tolerance below it.
    """
    tolerance_m = criteria.tip_tolerance_m
    if tip_shift_rms(data, parent, fit).max() >= tolerance_m:
        return True
    before_m = unexplained_tip_rms(data, parent).max()
    after_m = unexplained_tip_rms(data, fit).max()
    return bool(before_m > tolerance_m >= after_m)


def explains_its_only_trial(
    data: TrialData,
    parent: Fit,
    fit: Fit,
    touched: int,
    criteria: Criteria,
) -> bool:
    """Whether a contact removes enough misfit of the only trial that it touches."""
    before = unexplained_tip_rms(data, parent)
    after = unexplained_tip_rms(data, fit)
    fraction = explained_fractions(before, after)[touched]
    return bool(fraction > criteria.min_explained_fraction)


def survives_leave_one_out(
    data: TrialData,
    parent: Fit,
    fit: Fit,
    criteria: Criteria,
) -> bool:
    """Whether the evidence for a fit does not depend on a single trial."""
    needed = criteria.min_log_bayes_factor
    return (
        fixed_leave_one_out_gain(parent, fit) > needed
        or refitted_leave_one_out_gain(data, parent, fit) > needed
        or cross_validated_gain(data, parent, fit) > needed
    )


def is_supported(data: TrialData, parent: Fit, fit: Fit, criteria: Criteria) -> bool:
    """Whether the last cause of a fit is accepted."""
    return is_large_enough(data, parent, fit, criteria) and is_evident(
        data, parent, fit, criteria
    )


def is_evident(data: TrialData, parent: Fit, fit: Fit, criteria: Criteria) -> bool:
    """Whether trials support the last cause of a fit, however small its effect."""
    if not has_evidence(parent, fit, criteria) or fit.has_diverged:
        return False
    cause = fit.hypothesis.causes[-1]
    touched = trials_touched_by(data, fit, cause, criteria.tip_tolerance_m)
    if len(touched) == 1:
        return explains_its_only_trial(data, parent, fit, touched[0], criteria)
    if len(data.trials) == 1:  # a verdict on one trial names nothing
        return True
    return survives_leave_one_out(data, parent, fit, criteria)


def is_needed(without: Fit, fit: Fit, criteria: Criteria) -> bool:
    """Whether the evidence falls by the required Bayes factor without a cause."""
    return has_evidence(without, fit, criteria)


def predicts_heldout(gains: np.ndarray, explained_fraction: float) -> bool:
    """Whether a cause makes trials left out likelier, and their tips closer.

    A wrong cause may raise the likelihood alone by making misfit smoother but not
    smaller. A sum over trials would be dominated by a badly predicted one, such as a
    chaotic one (cross-validation by trials: Vehtari, Gelman, Gabry, Stat. Comput. 27,
    1413, 2017).

    Parameters
    ----------
    gains : numpy.ndarray, shape (K,)
        Gain of each trial's log-likelihood.
    explained_fraction : float
        Fraction of the tips' mean square error (`mean_explained_fraction`).
    """
    return bool(np.median(gains) > 0) and explained_fraction > 0


def is_inside_range(fit: Fit, cause: type[Effect]) -> bool:
    """Whether no amplitude of a cause is at an end of its range or too small.

    A cause at the end of its range probably stands for another one. Exceptions are the
    end at which it is absent, and amplitudes that are only lower bounds.
    """
    absent = fit.hypothesis.exponents_from({})
    amplitudes = amplitude_parameters(cause)
    indices = fit.hypothesis.parameter_indices(cause, amplitudes)
    for parameter, index in zip(amplitudes, indices, strict=True):
        chi = fit.chi[index]
        if abs(chi - absent[index]) <= ABSENCE_TOLERANCE:
            continue
        is_at_end = abs(chi - 0.5) > 0.5 - ABSENCE_TOLERANCE
        is_too_small = abs(parameter.value(chi)) < parameter.min_amplitude
        if is_too_small or (is_at_end and not parameter.is_lower_bound):
            return False
    return True


def trials_agree(probability: float) -> bool:
    """Whether a cause is probably present, by the scatter between trials.

    See `agreement`. The evidence of a model that leaves misfit is overconfident; the
    scatter of its estimates is not.
    """
    return probability > 0.5


def remainder_hides(difference_m: float, remainder_m: float) -> bool:
    """Whether rivals differ at the tip by no more than the best leaves unexplained."""
    return difference_m <= remainder_m


def misfit_remains(probability: float) -> bool:
    """Whether the misfit of some trial's tip probably exceeds the tolerance."""
    return probability > 0.5


def can_be_simulated(numbers: VerdictNumbers) -> bool:
    """Whether the simulation of no trial diverges with the fitted parameters."""
    return not numbers.diverged


def unresolved_by_simulation(
    uncertainty_m: np.ndarray, misfit_m: np.ndarray, criteria: Criteria
) -> float:
    """Compute the numerical uncertainty if too few trials are resolved [m], else 0.

    A trial is resolved if its numerical error is uncertain by no more than the
    tolerance, or by a small part of the misfit.

    Parameters
    ----------
    uncertainty_m, misfit_m : numpy.ndarray, shape (K,)
        Uncertainty of the numerical error, and misfit of the base model, at each tip
        [m].
    """
    allowed_m = np.sqrt(UNRESOLVED_FRACTION) * misfit_m
    allowed_m = np.maximum(allowed_m, criteria.tip_tolerance_m)
    is_unresolved = uncertainty_m > allowed_m
    needed = min(MIN_RESOLVED_TRIALS, len(uncertainty_m))
    if (~is_unresolved).sum() >= needed:
        return 0.0
    return float(uncertainty_m.max())


def agreement_is_resolved(numbers: VerdictNumbers) -> bool:
    """Whether simulation resolves enough trials to agree with them."""
    return numbers.unresolved_m == 0


def can_be_confirmed(numbers: VerdictNumbers) -> bool:
    """Whether there is a second trial to confirm a cause."""
    return numbers.trials > 1


def explains_enough(numbers: VerdictNumbers, criteria: Criteria) -> bool:
    """Whether the accepted causes remove enough of the base model's misfit.

    If misfit remains, something outside the library may have a larger effect than they.
    """
    if misfit_remains(numbers.misfit_probability):
        return numbers.explained_fraction > 0
    return numbers.explained_fraction >= criteria.min_explained_fraction


def predicts_better(numbers: VerdictNumbers) -> bool:
    """Whether the accepted causes improve predictions of held-out trials."""
    if not numbers.heldout_is_closer:
        return False
    if not misfit_remains(numbers.misfit_probability):
        return True
    return numbers.heldout_explained_fraction > 0
