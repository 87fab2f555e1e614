"""Search for causes, the most evident first, until the budget is used up.

A linear approximation ranks all effects of the library, and a few iterations refine the
best of them. If the best leaves too large a residual, effects are added to it. The most
probable causes are then fitted, and each of them is exchanged for all other effects.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from stringcast.stages.common import Progress
from stringcast.stages.explain.comparison import (
    NO_CAUSE,
    Comparer,
    Comparison,
    explains_half,
    noise_m,
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


@dataclass
class Budget:
    """Processor time that may be used.

    Parameters
    ----------
    seconds : processor time [s]
    progress : called with the used share
    longest_fit : longest time of a fit so far [s]
    longest_screening : longest time of a screening of all effects so far [s]
    """

    seconds: float
    progress: Progress
    longest_fit: float = 0.0
    longest_screening: float = 0.0

    def __post_init__(self) -> None:
        """Start the clock."""
        self.began = time.process_time()

    def is_used_up(self, fits: float = 1.0, screenings: float = 0.0) -> bool:
        """Return whether too little time is left for fits and screenings."""
        used = time.process_time() - self.began
        self.progress(min(used / max(self.seconds, 1e-9), 1.0))
        needed = fits * self.longest_fit + screenings * self.longest_screening
        return used + needed > self.seconds

    @contextmanager
    def measure_fit(self) -> Iterator[None]:
        """Measure the time of a fit."""
        began = time.process_time()
        yield
        self.longest_fit = max(self.longest_fit, time.process_time() - began)

    @contextmanager
    def measure_screening(self) -> Iterator[None]:
        """Measure the time of a screening."""
        began = time.process_time()
        yield
        taken = time.process_time() - began
        self.longest_screening = max(self.longest_screening, taken)


@dataclass(frozen=True)
class Finalist:
    """Effects that may be fitted in addition to causes.

    Parameters
    ----------
    effects : mostly one
    comparer : compares effects that are added to these causes
    comparison : comparison by a screening, or with earlier trials
    is_deferred : whether all others are fitted first
    """

    effects: tuple[type[Effect], ...]
    comparer: Comparer
    comparison: Comparison
    is_deferred: bool = False

    @property
    def is_slow(self) -> bool:
        """Whether stiff loads make a fit take SLOW_FITS times as long."""
        effects = find_effects(self.comparison.causes)
        return any(hasattr(effect, "bound") for effect in effects)


@dataclass
class CauseSearch:
    """Forward search for causes: effects are added to the most evident ones.

    Parameters
    ----------
    comparer : Comparer
        Compares effects added to the original model.
    effects : sequence of Effect types
        Candidate effects.
    compared : dict
        Fitted comparisons by their causes; the search adds to it.
    finalists : int
        Largest number of effects that are fitted after a screening.
    budget : Budget
        Processor time that may be used.
    is_surprising : bool
        Whether other causes are sought where those of earlier trials explain all.
    earlier : collection
        Probable causes of earlier trials.
    rivals : sequence of Finalist
        Those that were not fitted to these trials yet; their residual is NaN.
    """

    comparer: Comparer
    effects: Sequence[type[Effect]]
    compared: dict[tuple[str, ...], Comparison]
    finalists: int
    budget: Budget
    is_surprising: bool = False
    earlier: Collection[tuple[str, ...]] = ()
    rivals: Sequence[Finalist] = ()

    def __post_init__(self) -> None:
        """Initialise the search."""
        self.is_cut_short = False  # whether there was no time for a screening or a fit
        self.extended: set[tuple[str, ...]] = set()  # causes with all others tried
        # finalists by the causes to which they were added, the most evident first
        self.screened: dict[tuple[str, ...], list[Finalist]] = {}
        # largest gain of log evidence by a fit of these finalists
        self.fit_gains: dict[tuple[str, ...], float] = {}
        self.unfitted: set[tuple[str, ...]] = set()  # not fitted for lack of time
        self.noise_ratios: dict[tuple[str, ...], NoiseRatios] = {}

    @property
    def best(self) -> Comparison:
        """The most probable fitted causes."""
        return max(self.compared.values(), key=self.log_posterior)

    @property
    def most_probable(self) -> Comparison:
        """The most probable causes, fitted or not.

        Those for which there was no time are left out, so that others are still sought.
        """
        found = []
        for causes, each in self.all_compared().items():
            if causes not in self.unfitted:
                found.append(each)
        return max(found, key=self.log_posterior)

    @property
    def is_complete(self) -> bool:
        """Whether all likely causes were fitted."""
        return not self.is_cut_short

    def log_posterior(self, comparison: Comparison) -> float:
        """Return the log evidence with the prior odds of further causes."""
        further = max(len(comparison.causes) - 1, 0)
        return comparison.log_evidence - further * float(np.log(len(self.effects)))

    def all_compared(self) -> dict[tuple[str, ...], Comparison]:
        """Return all comparisons by their causes.

        A fit of other finalists might gain as much as that of their rivals.
        """
        found = {each.comparison.causes: each.comparison for each in self.rivals}
        found.update(self.compared)
        for base, finalists in self.screened.items():
            gain = self.fit_gains.get(base, 0.0)
            for each in finalists:
                expected = each.comparer.with_gain(each.comparison, gain)
                known = found.setdefault(expected.causes, expected)
                is_fitted = known.estimate is not None
                if not is_fitted and known.log_evidence < expected.log_evidence:
                    found[expected.causes] = expected
        return found

    def explaining(self) -> dict[tuple[str, ...], Comparison]:
        """Return the comparisons of causes that explain more than any part of them.

        They explain half of the residual beyond noise that a part of them leaves, where
        both residuals are known.
        """
        compared = self.all_compared()
        noise = noise_m(self.comparer.observations)
        found = {}
        for causes, each in compared.items():
            parts = []
            for part, other in compared.items():
                if part and set(part) < set(causes) and other.has_residual:
                    parts.append(other)
            explains_more = all(explains_half(each, part, noise) for part in parts)
            if explains_more or not each.has_residual:
                found[causes] = each
        return found

    def search(self, tolerance_m: float) -> None:
        """Add effects to the most probable causes while the residual exceeds the noise.

        Each step screens all effects. The most probable causes are then fitted, and
        their rivals. If they leave more than noise, effects are added to the next most
        probable causes. In the end, each of the best causes is exchanged for all other
        effects, because one that was added early may imitate another one.

        tolerance_m: tip misfit that is small [m].
        """
        while True:
            extendable = self.most_probable_extendable(tolerance_m)
            finalist = self.next_finalist(extendable, tolerance_m)
            if finalist is not None:
                self.fit(finalist)
            elif extendable is None:
                return
            elif self.has_time_to_extend(extendable):
                self.add_effect_to(extendable)
            else:
                self.is_cut_short = True
                return

    def has_time_to_extend(self, extendable: Comparison) -> bool:
        """Return whether there is time for a screening and a fit.

        The first screening is always made. An exchange needs no fit.
        """
        if not self.screened and len(self.compared) == 1:
            return True
        is_exchange = len(extendable.causes) < len(self.best.causes)
        return not self.budget.is_used_up(0.0 if is_exchange else 1.0, screenings=1.0)

    def next_finalist(
        self, extendable: Comparison | None, tolerance_m: float
    ) -> Finalist | None:
        """Choose the finalist to fit next; None to add effects to `extendable` first.

        extendable: most evident causes to which effects may be added.
        tolerance_m: tip misfit that is small [m].
        """
        waiting = self.waiting(tolerance_m)
        if not waiting:
            return None
        if extendable is None or extendable.causes != self.most_probable.causes:
            return waiting[0]
        return None if self.has_time_to_extend(extendable) else waiting[0]

    def waiting(self, tolerance_m: float) -> list[Finalist]:
        """List the finalists that may be as probable as the best causes, best first.

        tolerance_m: tip misfit that is small [m].
        """
        best = self.best
        is_explained = self.is_explained(best, tolerance_m)
        # with the log evidence that a fit may gain
        finalists = [(each, 0.0) for each in self.rivals]
        for base, screened in self.screened.items():
            gain = self.fit_gains.get(base, 0.0)
            finalists += [(each, gain) for each in screened[: self.finalists]]

        waiting = []
        for each, gain in finalists:
            causes = each.comparison.causes
            has_more_causes = len(causes) > len(best.causes)
            if causes in self.compared or causes in self.unfitted:
                continue
            if is_explained and has_more_causes:
                continue
            deficit = self.log_posterior(best) - self.log_posterior(each.comparison)
            if not best.causes or deficit < gain + MAX_DEFICIT:
                waiting.append(each)
        waiting.sort(
            key=lambda each: (each.is_deferred, -self.log_posterior(each.comparison))
        )
        return waiting

    def add_effect_to(self, base: Comparison) -> None:
        """Screen all effects in addition to causes; the most evident become finalists.

        A slow effect is deferred, unless it is far more evident than the others.
        """
        self.extended.add(base.causes)
        comparer = self.comparer.with_base(base)
        with self.budget.measure_screening():
            screened = self.screen_effects(comparer)
        screened.sort(key=lambda each: -each.comparison.log_evidence)
        quick = [each.comparison.log_evidence for each in screened if not each.is_slow]
        kept = self.screened.setdefault(base.causes, [])
        for each in screened:
            lead = each.comparison.log_evidence - max(quick, default=-np.inf)
            is_deferred = each.is_slow and lead < MAX_DEFICIT
            kept.append(replace(each, is_deferred=is_deferred))

    def fit(self, finalist: Finalist) -> None:
        """Fit a finalist from new starts and from the best of its parts."""
        causes = finalist.comparison.causes
        if self.budget.is_used_up(SLOW_FITS if finalist.is_slow else 1.0):
            self.unfitted.add(causes)
            self.is_cut_short = True
            return
        parts = []
        for part, each in self.compared.items():
            if set(part) < set(causes):
                parts.append(each)
        with self.budget.measure_fit():
            start = max(parts, key=self.log_posterior).estimate
            fitted = finalist.comparer.fit(finalist.effects, start)
        self.compared[causes] = fitted
        if not finalist.comparison.has_residual:
            return  # other trials say nothing of what a fit gains over a screening
        gain = fitted.log_evidence - finalist.comparison.log_evidence
        base = finalist.comparer.base.causes
        self.fit_gains[base] = max(gain, self.fit_gains.get(base, 0.0))

    def screen_effects(self, comparer: Comparer) -> list[Finalist]:
        """Compare effects added to causes.

        Effects are ranked in linear approximation, and the best are refined.
        """
        base = comparer.base.causes
        known = self.all_compared()
        squares = {}
        for effect in self.effects:
            if effect.name in base or tuple(sorted([*base, effect.name])) in known:
                continue
            squares[effect] = comparer.linear_square(effect)
        ranked = sorted(squares, key=lambda effect: squares[effect])
        is_exchange = len(base) < len(self.best.causes)
        screened: list[Finalist] = []
        for effect in ranked[: self.finalists if is_exchange else REFINED_EFFECTS]:
            compared = comparer.screen((effect,))
            screened.append(Finalist((effect,), comparer, compared))
        return screened

    def most_probable_extendable(self, tolerance_m: float) -> Comparison | None:
        """Return the most probable causes to which adding effects may help, if any.

        tolerance_m: tip misfit that is small [m].
        """
        best = self.best
        nothing = self.compared[NO_CAUSE]
        if NO_CAUSE not in self.extended and not explains_half(best, nothing):
            return nothing  # the causes of earlier trials explain too little
        leading = self.most_probable
        if leading.estimate is None:
            noise = noise_m(self.comparer.observations)
            leaves_more = leading.rms_m > MAX_NOISE_RATIO * noise
            return leading if self.is_extendable(leading) and leaves_more else None
        if best.causes and not self.is_explained(best, tolerance_m):
            return self.extendable_rival(best) or self.unexchanged_part(best)
        is_settled = self.is_confirmed(best) and not self.is_surprising
        return None if is_settled else self.unexchanged_part(best)

    def is_extendable(self, comparison: Comparison) -> bool:
        """Return whether effects may be added to causes and were not yet.

        Rivals of earlier trials are fitted first.
        """
        causes = comparison.causes
        is_short = len(causes) < MAX_CAUSES and comparison.has_residual
        return is_short and causes not in self.extended

    def extendable_rival(self, best: Comparison) -> Comparison | None:
        """Return the most probable extendable causes with a small deficit, if any."""
        gain = best.log_evidence
        max_deficit = max(MAX_EXTENDED_DEFICIT, MAX_EXTENDED_FRACTION * gain)
        rivals = []
        for each in self.all_compared().values():
            if self.is_extendable(each) and gain - each.log_evidence < max_deficit:
                rivals.append(each)
        return max(rivals, key=self.log_posterior, default=None)

    def unexchanged_part(self, best: Comparison) -> Comparison | None:
        """Return the best causes without one of them, if no effect was added to these.

        Where they were not fitted, added effects start from the fit of all causes.
        """
        for left_out in best.causes:
            part = tuple(cause for cause in best.causes if cause != left_out)
            if part in self.extended:
                continue
            if part in self.compared:
                return self.compared[part]
            known = []
            for causes, each in self.all_compared().items():
                if set(causes) <= set(part):
                    known.append(each.log_evidence)
            return replace(best, causes=part, log_evidence=max(known))
        return None

    def is_confirmed(self, best: Comparison) -> bool:
        """Return whether causes were likely before and leave only noise in trials.

        Frames that the mesh does not resolve count as well. On string A, a rotated
        grasp was mistaken for wind: it left only noise until the string whipped, but 3
        times the noise in whole casts. A single cause needs no such confirmation.
        """
        if best.causes not in self.earlier:
            return False
        if len(best.causes) == 1:
            return True
        noise = noise_m(self.comparer.observations)
        return best.rms_m <= MAX_NOISE_RATIO * noise

    def are_rivals_compared(self, best: Comparison, tolerance_m: float) -> bool:
        """Return whether each of the best causes was exchanged for all other effects.

        tolerance_m: tip misfit that is small [m].
        """
        if not best.causes or not self.is_explained(best, tolerance_m):
            return False
        return self.unexchanged_part(best) is None

    def is_explained(self, comparison: Comparison, tolerance_m: float) -> bool:
        """Return whether fitted causes leave a small misfit and only noise.

        tolerance_m: tip misfit that is small [m].
        """
        if not comparison.causes or not self.has_small_misfit(comparison, tolerance_m):
            return False
        return self.noise_ratios_of(comparison).explain_all

    def has_small_misfit(self, comparison: Comparison, tolerance_m: float) -> bool:
        """Return whether fitted causes leave a small misfit, or only the mesh error.

        tolerance_m: tip misfit that is small [m].
        """
        if tip_rms_m(comparison.estimate) <= tolerance_m:
            return True
        return self.noise_ratios_of(comparison).leave_only_mesh_error

    def noise_ratios_of(self, comparison: Comparison) -> NoiseRatios:
        """Compare the residual of fitted causes with the noise."""
        causes = comparison.causes
        if causes not in self.noise_ratios:
            estimate = self.comparer.base.estimate
            assert estimate is not None
            assert comparison.estimate is not None
            self.noise_ratios[causes] = compare_with_noise(
                self.comparer.model,
                self.comparer.observations,
                (estimate, comparison.estimate),
            )
        return self.noise_ratios[causes]
