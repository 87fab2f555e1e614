"""The rules that decide whether a cause is accepted and what the verdict is.

A **candidate** is compared with the fit without it (its parent). One at the end of its
range goes after rivals inside theirs that explain `min_explained_fraction` of as much:

=========================  =========================================================
rule                       passes if
=========================  =========================================================
`is_resolved`              simulation with it resolves at least two trials, or all
                           trials if it would replace an accepted cause; if not, it
                           is no more than indistinguishable from the best
`has_evidence`             its Bayes factor is at least 1/alpha
`moves_tip_enough`         it moves the tip of a trial by `tip_tolerance_m`
`explains_its_only_trial`  it touches the string in a single trial, and removes
                           `min_explained_fraction` of the misfit there
`survives_leave_one_out`   its Bayes factor exceeds 1/alpha without the trial that
                           supports it most: fits kept, refitted, or cross-validated
=========================  =========================================================

An **accepted cause** stays while later causes are added:

=========================  =========================================================
`is_needed`                without it the Bayes factor drops by more than 1/alpha
`predicts_heldout`         trials are predicted by fits to the others: it raises the
                           likelihood of the median trial, and tips are closer
`is_inside_range`          none of its amplitudes is at an end of its range, or
                           too small to be what it is
`trials_agree`             if misfit remains, it is there with a probability above
                           one half by how fits without one trial each scatter
=========================  =========================================================

The **verdict** names the accepted causes only if all of these pass:

=========================  =========================================================
`can_be_simulated`         no trial diverges with the fitted parameters
`can_be_confirmed`         there is a second trial
`explains_enough`          the causes remove `min_explained_fraction` of the misfit;
                           if misfit remains, they make it smaller
`predicts_better`          the extended model predicts trials that it was not fitted
                           to better; if misfit remains, their tips are closer
=========================  =========================================================

If misfit remains, the verdict on the named causes is `partial`. Whether they are there
is then judged by two things: their effect is the same in all trials (`trials_agree`),
and they leave little where the model holds (`stand_ins`).
"Misfit remains" (`misfit_remains`) if the tip of some trial is off by more than
`tip_tolerance_m` with a probability above one half.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from pydantic import Field

from stringcast.stages.diagnose.measures import (
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
NEGLIGIBLE_LOG_EVIDENCE = 1.0  # not worth a mention, by the same
MIN_RESOLVED_TRIALS = 2  # what is found in one could not be confirmed by another

Fraction = Annotated[float, Field(gt=0, lt=1)]
Metres = Annotated[float, Field(gt=0, lt=0.1)]


@dataclass(frozen=True)
class Criteria:
    """The numbers that decide.

    Attributes
    ----------
    max_causes : int
    coverage : float
        Probability of credible sets and of intervals.
    alpha : float
        A cause is accepted with a Bayes factor of at least its inverse.
    tip_tolerance_m : float
        What counts at the tip [m]: more misfit must be explained, and a cause that
        moves it less is too small to report. Trials must be resolved to it.
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
        """Logarithm of the Bayes factor from which a cause is accepted."""
        return float(-np.log(self.alpha))

    @property
    def deciding_log_odds(self) -> float:
        """Log odds from which one of two hypotheses makes a credible set alone."""
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
        For each place that more likely holds a cause than not, the effects that explain
        the trials about equally well.
    inclusion_probability : dict
        Probability that each effect is active.
    diverged : bool
        Whether a trial cannot be simulated with the fitted parameters.
    misfit_probability, base_misfit_probability : float
        That the extended or the base model is off by more than the tolerance.
    explained_fraction : float
        Of the base model's mean square misfit, by the causes together.
    mesh_too_coarse : bool
        Whether the configured mesh alone displaces the tip by more than the tolerance.
    heldout_is_closer : bool
        Whether the extended model predicts trials better that it was not fitted to.
    heldout_explained_fraction : float
        Of the base model's misfit in these trials.
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
        Of the discretisation error at each tip with the candidate and without [m]. It
        may reach the tolerance, that of the worst trial without the candidate, or a
        misfit that may remain in the trial anyway.
    needed : int
        Number of trials that must be resolved.
    misfit_allowance_m : numpy.ndarray, shape (K,)
        That misfit [m].
    """
    allowed = max(before_m.max(), criteria.tip_tolerance_m)
    allowed = np.maximum(allowed, misfit_allowance_m)
    resolved = (uncertainty_m <= allowed).sum()
    return bool(resolved >= needed)


def has_evidence(parent: Fit, fit: Fit, criteria: Criteria) -> bool:
    """Whether the Bayes factor of a fit over its parent is at least 1/alpha."""
    return fit.log_evidence - parent.log_evidence >= criteria.min_log_bayes_factor


def moves_tip_enough(
    data: TrialData,
    parent: Fit,
    fit: Fit,
    criteria: Criteria,
) -> bool:
    """Whether the tip of some trial differs enough between a fit and its parent."""
    shift = tip_shift_rms(data, parent, fit)
    return bool(shift.max() >= criteria.tip_tolerance_m)


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
    """Whether the evidence for a fit does not rest on a single trial."""
    needed = criteria.min_log_bayes_factor
    return (
        fixed_leave_one_out_gain(parent, fit) > needed
        or refitted_leave_one_out_gain(data, parent, fit) > needed
        or cross_validated_gain(data, parent, fit) > needed
    )


def is_supported(data: TrialData, parent: Fit, fit: Fit, criteria: Criteria) -> bool:
    """Whether the last cause of a fit is accepted in addition to its parent's."""
    return moves_tip_enough(data, parent, fit, criteria) and is_evident(
        data, parent, fit, criteria
    )


def is_evident(data: TrialData, parent: Fit, fit: Fit, criteria: Criteria) -> bool:
    """Whether trials support the last cause of a fit, however little it does."""
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
    """Whether the evidence falls by the needed Bayes factor without a cause."""
    return has_evidence(without, fit, criteria)


def predicts_heldout(gains: np.ndarray, explained_fraction: float) -> bool:
    """Whether a cause makes trials left out likelier, and their tips closer.

    The likelihood alone may rise by a stand-in, which makes misfit smoother and not
    smaller. The sum over trials would follow one that is predicted badly, such as a
    chaotic one (cross-validation by trials: Vehtari, Gelman, Gabry, Stat. Comput. 27,
    1413, 2017).

    Parameters
    ----------
    gains : numpy.ndarray, shape (K,)
        Of the log-likelihood of each trial.
    explained_fraction : float
        Of the tips' mean square error, as of `mean_explained_fraction`.
    """
    return bool(np.median(gains) > 0) and explained_fraction > 0


def is_inside_range(fit: Fit, cause: type[Effect]) -> bool:
    """Whether no amplitude of a cause is at an end of its range, or too small for it.

    One that would go on beyond its range most likely stands for another cause. An end
    at which the cause is absent does not count, nor one that is only a lower bound.
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
    """Whether a cause is more likely there than not, by the scatter between trials.

    See `agreement`. The evidence of a model that leaves misfit is too sure of itself;
    how its estimates scatter between trials is not.
    """
    return probability > 0.5


def remainder_hides(difference_m: float, remainder_m: float) -> bool:
    """Whether two rivals differ at the tip by no more than the best of them leaves."""
    return difference_m <= remainder_m


def misfit_remains(probability: float) -> bool:
    """Whether the tip of some trial is more likely off by the tolerance than not."""
    return probability > 0.5


def can_be_simulated(numbers: VerdictNumbers) -> bool:
    """Whether the simulation of no trial diverges with the fitted parameters."""
    return not numbers.diverged


def can_be_confirmed(numbers: VerdictNumbers) -> bool:
    """Whether there is a second trial to confirm what is found in the first."""
    return numbers.trials > 1


def explains_enough(numbers: VerdictNumbers, criteria: Criteria) -> bool:
    """Whether the accepted causes remove enough of the base model's misfit.

    If misfit remains, something outside the library may do more than the causes.
    """
    if misfit_remains(numbers.misfit_probability):
        return numbers.explained_fraction > 0
    return numbers.explained_fraction >= criteria.min_explained_fraction


def predicts_better(numbers: VerdictNumbers) -> bool:
    """Whether the accepted causes help to predict trials that were not fitted."""
    if not numbers.heldout_is_closer:
        return False
    if not misfit_remains(numbers.misfit_probability):
        return True
    return numbers.heldout_explained_fraction > 0
