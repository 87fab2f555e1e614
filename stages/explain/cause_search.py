"""Search for sets of causes, the most probable first, until the budget is used up.

Two moves lead from a set of causes to another one, as in subset selection for
regression [1]_. A forward step adds an effect. A swap exchanges a cause for another
effect, because one that was added early may imitate another one. It may also explain
nothing once the others are known; so the best causes are compared without each of them.

Both screen all effects in addition to a **base**: the set of causes of a forward step,
or that of a swap without the exchanged cause. In a screening, a linear approximation
ranks the effects and a few iterations refine the best. The most evident ones, the
finalists, are then fitted from new starts.

References
----------
.. [1] Miller, Subset Selection in Regression, 2nd edition (2002), chapter 3.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from stringcast.stages.explain.budget import Budget
from stringcast.stages.explain.comparer import SCREENING_ACCURACY, Comparer
from stringcast.stages.explain.comparison import (
    NO_CAUSE,
    NOISE_RATIO,
    Causes,
    Comparison,
    explains_half,
    log_prior_odds_of_further_causes,
    tip_rms_m,
)
from stringcast.stages.explain.noise_ratios import (
    MAX_NOISE_RATIO,
    NoiseRatios,
    compare_with_noise,
)
from stringcast.stages.model.effect import Effect
from stringcast.stages.model.library import find_effects

MAX_CAUSES = 3  # that act together
SLOW_FITS = 5.0  # duration of a fit with stiff loads, in other fits
# Largest deficit of log evidence at which causes are fitted, after a screening. In
# seven looks, a fit gained 0.2 to 1.9 of it. The next plan would not use other causes.
MAX_DEFICIT = 3.0
# Largest deficit of log evidence at which effects are added to causes that leave more
# than noise: 15, or half of the gain of the best
MAX_EXTENDED_DEFICIT = 15.0
MAX_EXTENDED_FRACTION = 0.5
# Effects that are refined after the linear ranking. In it, each of three hidden causes
# of string D was at least seventh.
REFINED_EFFECTS = 7


@dataclass(frozen=True)
class Finalist:
    """Effects that may be fitted in addition to a base.

    Parameters
    ----------
    effects : mostly one; none to fit the base itself
    comparer : compares effects that are added to the base
    comparison : comparison by a screening, or with earlier trials
    is_deferred : whether all others are fitted first
    """

    effects: tuple[type[Effect], ...]
    comparer: Comparer
    comparison: Comparison
    is_deferred: bool = False

    @property
    def is_rival(self) -> bool:
        """Whether only earlier trials were compared with the causes."""
        return not self.comparison.has_residual

    @property
    def is_slow(self) -> bool:
        """Whether stiff loads make a fit take SLOW_FITS times as long."""
        effects = find_effects(self.comparison.causes)
        return any(hasattr(effect, "bound") for effect in effects)


@dataclass
class Screening:
    """All effects in addition to one base.

    Parameters
    ----------
    finalists : the most evident first
    fit_gain : largest log evidence that a fit of one of them gained over its screening
    """

    finalists: Sequence[Finalist]
    fit_gain: float = 0.0


@dataclass
class CauseSearch:
    """Search for causes by forward steps and swaps.

    Parameters
    ----------
    comparer : Comparer
        Compares effects added to the original model.
    effects : sequence of Effect types
        Candidate effects.
    fitted : dict
        Comparisons by fits; the search adds to it. It contains that without causes.
    max_finalists : int
        Largest number of effects that are fitted after a screening.
    tolerance_m : float
        Tip misfit that is small [m].
    budget : Budget
        Processor time that may be used.
    is_surprising : bool
        Whether other causes are sought where those of earlier trials explain all.
    earlier : collection
        Probable causes of earlier trials.
    rivals : sequence of Finalist
        Those of them that were not fitted to these trials; their residual is NaN.
    screened_earlier : collection
        Bases of screenings with earlier trials.

    Attributes
    ----------
    screenings : dict
        Screenings by the causes of their base.
    parts : dict
        Finalists of explaining causes without one of them, by their causes.
    rival_gain : float
        Largest log evidence that the fit of a rival gained over that of earlier trials.
    unfitted : set
        Causes for whose fit there was no time.
    is_complete : bool
        Whether there was time for all screenings and fits.
    """

    comparer: Comparer
    effects: Sequence[type[Effect]]
    fitted: dict[Causes, Comparison]
    max_finalists: int
    tolerance_m: float
    budget: Budget
    is_surprising: bool = False
    earlier: Collection[Causes] = ()
    rivals: Sequence[Finalist] = ()
    screened_earlier: Collection[Causes] = ()
    screenings: dict[Causes, Screening] = field(default_factory=dict, init=False)
    parts: dict[Causes, Finalist] = field(default_factory=dict, init=False)
    rival_gain: float = field(default=0.0, init=False)
    unfitted: set[Causes] = field(default_factory=set, init=False)
    is_complete: bool = field(default=True, init=False)
    _noise_ratios: dict[Causes, NoiseRatios] = field(default_factory=dict, init=False)

    def run(self) -> None:
        """Screen and fit causes until no move can help, or until time is up.

        A base that leads all others is extended before anything is fitted, except for
        rivals: a screening leaves them out.
        """
        while True:
            self.compare_parts()
            base = self.next_base()
            waiting = self.waiting_finalists()
            leads = base is not None and base.causes == self.most_probable.causes
            if waiting and (waiting[0].is_rival or not leads):
                self.fit(waiting[0])
            elif base is None:
                return
            elif self.has_time_to_screen(base):
                self.screen(base)
            elif waiting:
                self.fit(waiting[0])
            else:
                self.is_complete = False
                return

    def next_base(self) -> Comparison | None:
        """Choose the causes to which effects are added next; None if that cannot help.

        In this order:

        - the original model, unless causes of earlier trials explain half;
        - the most probable causes, if they are not fitted and leave more than noise;
        - other probable causes, if the best fit leaves more than noise;
        - the best causes without one of them, unless earlier trials confirm them.
        """
        best = self.best
        original = self.fitted[NO_CAUSE]
        if NO_CAUSE not in self.screenings and not explains_half(best, original):
            return original
        leading = self.most_probable
        if leading.estimate is None:
            if self.is_extendable(leading) and not self.leaves_only_noise(leading):
                return leading
            return None
        if best.causes and not self.is_explained(best):
            return self.extendable_rival() or self.base_of_swap(best)
        if self.is_confirmed(best) and not self.is_surprising:
            return None
        # With many trials, causes that explain hardly anything have evidence, too
        named = self.best_without_idle_causes
        return self.base_of_swap(best) or self.base_of_swap(named)

    def extendable_rival(self) -> Comparison | None:
        """Return the most probable extendable causes with a small deficit, if any."""
        gain = self.best.log_evidence
        max_deficit = max(MAX_EXTENDED_DEFICIT, MAX_EXTENDED_FRACTION * gain)
        rivals = []
        for comparison in self.comparisons().values():
            deficit = gain - comparison.log_evidence
            if self.is_extendable(comparison) and deficit < max_deficit:
                rivals.append(comparison)
        return max(rivals, key=self.log_posterior, default=None)

    def is_extendable(self, comparison: Comparison) -> bool:
        """Return whether effects may be added to causes and were not yet.

        Rivals of earlier trials are fitted first.
        """
        causes = comparison.causes
        is_short = len(causes) < MAX_CAUSES and comparison.has_residual
        return is_short and causes not in self.screenings

    def base_of_swap(self, best: Comparison) -> Comparison | None:
        """Return the best causes without one that was not yet exchanged, if any.

        If this part was not fitted, its residual is not known, and added effects start
        from the fit of all causes.
        """
        for part in parts_of(best.causes):
            if part in self.screenings:
                continue
            if part in self.fitted:
                return self.fitted[part]
            if part in self.parts:
                return self.parts[part].comparison
            known = []
            for causes, comparison in self.comparisons().items():
                if set(causes) <= set(part):
                    known.append(comparison.log_evidence)
            return Comparison(part, max(known), np.nan, screened=best.exponents)
        return None

    def compare_parts(self) -> None:
        """Compare the best causes without each of them, if they explain the trials.

        A cause that was added early may explain nothing once the others are known.
        """
        best = self.best
        if len(best.causes) < 2 or not self.is_explained(best):
            return
        known = self.comparisons()
        for part in parts_of(best.causes):
            if part not in known:
                base = Comparison(part, 0.0, np.nan, screened=best.exponents)
                comparer = self.comparer.with_base(base)
                self.parts[part] = Finalist((), comparer, comparer.screen_base())

    def has_time_to_screen(self, base: Comparison) -> bool:
        """Return whether there is time for a screening and a fit.

        The first screening is always made. A swap needs no fit.
        """
        if not self.screenings and len(self.fitted) == 1:
            return True
        fits = 0.0 if self.is_swap(base) else 1.0
        return not self.budget.is_used_up(fits, screenings=1.0)

    def is_swap(self, base: Comparison) -> bool:
        """Return whether a base has fewer causes than the best fit."""
        return len(base.causes) < len(self.best.causes)

    def screen(self, base: Comparison) -> None:
        """Compare all effects in addition to a base.

        Effects are ranked in linear approximation, and the best are refined. A slow
        effect is deferred, unless it is far more evident than the others.
        """
        comparer = self.comparer.with_base(base)
        with self.budget.measure_screening():
            comparisons = self.comparisons()
            mean_squares = {}
            for effect in self.effects:
                causes = tuple(sorted([*base.causes, effect.name]))
                if effect.name not in base.causes and causes not in comparisons:
                    mean_squares[effect] = comparer.linear_mean_square(effect)
            ranked = sorted(mean_squares, key=lambda effect: mean_squares[effect])
            count = self.max_finalists if self.is_swap(base) else REFINED_EFFECTS
            finalists = []
            for effect in ranked[:count]:
                comparison = comparer.screen(effect)
                finalists.append(Finalist((effect,), comparer, comparison))

            finalists = settle_leaders(finalists)

        finalists.sort(key=lambda each: -each.comparison.log_evidence)
        quick = [f.comparison.log_evidence for f in finalists if not f.is_slow]
        for number, finalist in enumerate(finalists):
            lead = finalist.comparison.log_evidence - max(quick, default=-np.inf)
            is_deferred = finalist.is_slow and lead < MAX_DEFICIT
            finalists[number] = replace(finalist, is_deferred=is_deferred)
        self.screenings[base.causes] = Screening(finalists)

    def waiting_finalists(self) -> list[Finalist]:
        """List the finalists that may be as probable as the best causes.

        Rivals of earlier trials come first, and then the most probable.
        """
        # Each with the gain that a fit may have
        finalists = [(rival, self.rival_gain) for rival in self.rivals]
        finalists += [(part, 0.0) for part in self.parts.values()]
        for screening in self.screenings.values():
            for finalist in screening.finalists[: self.max_finalists]:
                finalists.append((finalist, screening.fit_gain))

        best = self.best
        waiting = []
        for finalist, fit_gain in finalists:
            causes = finalist.comparison.causes
            if causes in self.fitted or self.is_ruled_out(causes):
                continue
            probability = self.log_posterior(finalist.comparison)
            deficit = self.log_posterior(best) - probability
            if not best.causes or deficit < fit_gain + MAX_DEFICIT:
                rank = (not finalist.is_rival, finalist.is_deferred, -probability)
                waiting.append((rank, finalist))
        waiting.sort(key=lambda ranked: ranked[0])
        return [finalist for _, finalist in waiting]

    def fit(self, finalist: Finalist) -> None:
        """Fit a finalist from new starts and from the most probable fit."""
        causes = finalist.comparison.causes
        if self.budget.is_used_up(SLOW_FITS if finalist.is_slow else 1.0):
            self.unfitted.add(causes)
            self.is_complete = False
            return
        with self.budget.measure_fit():
            fitted = finalist.comparer.fit(finalist.effects, self.best.estimate)
        self.fitted[causes] = fitted
        gain = fitted.log_evidence - finalist.comparison.log_evidence
        if finalist.is_rival:
            self.rival_gain = max(gain, self.rival_gain)
        elif causes not in self.parts:
            screening = self.screenings[finalist.comparer.base.causes]
            screening.fit_gain = max(gain, screening.fit_gain)

    @property
    def best(self) -> Comparison:
        """The most probable fitted causes."""
        return max(self.fitted.values(), key=self.log_posterior)

    @property
    def best_without_idle_causes(self) -> Comparison:
        """The most probable fitted causes that explain more than any part of them."""
        fitted = []
        for comparison in self.comparisons_without_idle_causes().values():
            if comparison.estimate is not None:
                fitted.append(comparison)
        return max(fitted, key=self.log_posterior)

    @property
    def most_probable(self) -> Comparison:
        """The most probable causes, fitted or not.

        Those that will not be fitted are left out, so that others are still sought.
        """
        possible = []
        for causes, comparison in self.comparisons().items():
            if not self.is_ruled_out(causes):
                possible.append(comparison)
        return max(possible, key=self.log_posterior)

    def is_ruled_out(self, causes: Causes) -> bool:
        """Return whether causes are not fitted: no time, or fewer explain all."""
        best = self.best
        has_more_causes = len(causes) > len(best.causes)
        return causes in self.unfitted or (has_more_causes and self.is_explained(best))

    def log_posterior(self, comparison: Comparison) -> float:
        """Return the log evidence with the prior odds of further causes."""
        candidates = len(self.effects)
        prior_odds = log_prior_odds_of_further_causes(comparison.causes, candidates)
        return comparison.log_evidence + prior_odds

    def comparisons(self) -> dict[Causes, Comparison]:
        """Return the comparisons of all causes: by a fit, else the most evident one.

        A fit might gain as much for a finalist as for others of its screening, and for
        a rival as for other rivals.
        """
        known = {}
        for rival in self.rivals:
            blocks = rival.comparer.blocks
            expected = rival.comparison.with_gain(self.rival_gain, blocks)
            known[expected.causes] = expected
        for causes, part in self.parts.items():
            known[causes] = part.comparison
        known.update(self.fitted)
        for screening in self.screenings.values():
            for finalist in screening.finalists:
                blocks = finalist.comparer.blocks
                expected = finalist.comparison.with_gain(screening.fit_gain, blocks)
                other = known.setdefault(expected.causes, expected)
                is_fitted = other.estimate is not None
                if not is_fitted and other.log_evidence < expected.log_evidence:
                    known[expected.causes] = expected
        return known

    def comparisons_without_idle_causes(self) -> dict[Causes, Comparison]:
        """Return the comparisons of causes that explain more than any part of them.

        They explain half of the residual beyond noise that a part of them leaves, where
        both residuals are known.
        """
        comparisons = self.comparisons()
        kept = {}
        for causes, comparison in comparisons.items():
            explains_more = True
            for part, other in comparisons.items():
                is_part = part and set(part) < set(causes) and other.has_residual
                if is_part and not explains_half(comparison, other, NOISE_RATIO):
                    explains_more = False
            if explains_more or not comparison.has_residual:
                kept[causes] = comparison
        return kept

    def leaves_only_noise(self, comparison: Comparison) -> bool:
        """Return whether causes leave only noise in whole trials.

        Frames that the mesh does not resolve count as well.
        """
        return comparison.residual_ratio <= MAX_NOISE_RATIO

    def is_confirmed(self, best: Comparison) -> bool:
        """Return whether causes were likely before and leave only noise in trials.

        On string A, a rotated grasp was mistaken for wind: it left only noise until the
        string whipped, but 3 times the noise in whole casts. A single cause need not
        leave only noise.
        """
        if best.causes not in self.earlier:
            return False
        return len(best.causes) == 1 or self.leaves_only_noise(best)

    def untried_share(self) -> float:
        """Compute the share of untried sets among those next to the most probable one.

        Those next to it have another effect in place of one of its causes, or one more
        if it leaves more than noise. If all are equally likely, whatever the order in
        which they were tried, their share is the probability that the best of all is
        among the untried.
        """
        compared = self.comparisons_without_idle_causes().values()
        leading = max(compared, key=self.log_posterior)
        is_fitted = leading.estimate is not None
        if self.is_complete or (is_fitted and self.is_confirmed(leading)):
            return 0.0
        bases = parts_of(leading.causes)
        is_explained = is_fitted and self.is_explained(leading)
        if len(leading.causes) < MAX_CAUSES and not is_explained:
            bases.append(leading.causes)
        near = {leading.causes}
        for base in bases:
            near |= self.sets_around(base)

        tried = set(self.comparisons())
        for base in self.screenings:
            tried |= self.sets_around(base)
        # Causes that lost in earlier trials may act in trials with an unexplained rest
        if is_explained:
            for base in self.screened_earlier:
                tried |= self.sets_around(base)
        return len(near - tried) / len(near)

    def sets_around(self, base: Causes) -> set[Causes]:
        """Return the sets of causes that a screening compares: a base and an effect."""
        added = {effect.name for effect in self.effects} - set(base)
        return {tuple(sorted([*base, name])) for name in added}

    def is_exchanged(self, best: Comparison) -> bool:
        """Return whether each of the explaining causes was exchanged for all others."""
        return self.is_explained(best) and self.base_of_swap(best) is None

    def is_explained(self, comparison: Comparison) -> bool:
        """Return whether fitted causes leave only noise, and a small misfit at the tip.

        A larger misfit may be the error of the mesh.
        """
        if not comparison.causes:
            return False
        has_small_misfit = tip_rms_m(comparison.estimate) <= self.tolerance_m
        ratios = self.noise_ratios_of(comparison)
        return ratios.explain_all and (has_small_misfit or ratios.leave_only_mesh_error)

    def noise_ratios_of(self, comparison: Comparison) -> NoiseRatios:
        """Compare the residual of fitted causes with the noise."""
        causes = comparison.causes
        if causes not in self._noise_ratios:
            estimate = self.comparer.base.estimate
            assert estimate is not None
            assert comparison.estimate is not None
            self._noise_ratios[causes] = compare_with_noise(
                self.comparer.model,
                self.comparer.observations,
                (estimate, comparison.estimate),
            )
        return self._noise_ratios[causes]


def settle_leaders(finalists: Sequence[Finalist]) -> list[Finalist]:
    """Settle the screenings that may lead, the most evident first.

    One may lead if it is behind by no more than the largest gain of another. Without
    this, effects that are absent were added to the right one, and all gained as much as
    it alone would have gained.
    """
    settled: list[Finalist] = []
    largest_gain = SCREENING_ACCURACY
    for finalist in sorted(finalists, key=lambda each: -each.comparison.log_evidence):
        comparison = finalist.comparison
        evidence = comparison.log_evidence
        best = max((each.comparison.log_evidence for each in settled), default=evidence)
        if evidence + largest_gain >= best:
            comparison = finalist.comparer.settle(finalist.effects, comparison)
            largest_gain = max(largest_gain, comparison.log_evidence - evidence)
        settled.append(replace(finalist, comparison=comparison))
    return settled


def parts_of(causes: Causes) -> list[Causes]:
    """List causes without each of them."""
    return [tuple(c for c in causes if c != left_out) for left_out in causes]
