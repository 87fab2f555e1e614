"""Search for causes, the most evident first, until the budget is used up.

Comparisons on a coarse mesh rank all effects of the library. The most evident ones are
then fitted. If the best fit leaves too large a residual, effects are added to it.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from stringcast.stages.common import Progress
from stringcast.stages.explain.comparison import (
    NO_CAUSE,
    Comparer,
    Comparison,
    explains_half,
    most_evident_fit,
    noise_m,
    rms_m,
    tip_rms_m,
)
from stringcast.stages.explain.noise_ratios import NoiseRatios, compare_with_noise
from stringcast.stages.model.effect import Effect

MAX_CAUSES = 3  # that act together
SLOW_FITS = 5.0  # duration of a fit with stiff loads, in other fits
# Largest deficit of log evidence on the coarse mesh of an effect that is fitted. A fit
# hardly makes up for more.
MAX_DEFICIT = 15.0
# Largest deficit as a share of the best effect's gain, if larger than MAX_DEFICIT. Of
# two effects that fits could not distinguish, one had a deficit of 16 at a gain of 61.
MAX_DEFICIT_FRACTION = 0.5
# Effects that are refined after the linear ranking. In it, each of three hidden causes
# of string D was at least seventh.
REFINED_EFFECTS = 10


def max_deficit(gain: float) -> float:
    """Return the largest deficit of log evidence at which an effect is fitted.

    gain: gain of log evidence of the best effect.
    """
    return max(MAX_DEFICIT, MAX_DEFICIT_FRACTION * gain)


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
    effects : effects to add, usually one
    comparer : compares effects added to these causes
    comparison : comparison on the coarse mesh, or with earlier trials
    is_deferred : whether all others are fitted first
    """

    effects: tuple[type[Effect], ...]
    comparer: Comparer
    comparison: Comparison
    is_deferred: bool = False

    @property
    def is_slow(self) -> bool:
        """Whether stiff loads make a fit take SLOW_FITS times as long."""
        return any(hasattr(effect, "bound") for effect in self.effects)


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
        All comparisons by their causes; the search adds to it.
    finalists : int
        Largest number of effects that are fitted after a screening.
    budget : Budget
        Processor time that may be used.
    is_surprising : bool
        Whether to search even if the causes of earlier trials explain everything.
    """

    comparer: Comparer
    effects: Sequence[type[Effect]]
    compared: dict[tuple[str, ...], Comparison]
    finalists: int
    budget: Budget
    is_surprising: bool = False

    def __post_init__(self) -> None:
        """Initialise the search."""
        self.is_cut_short = False  # whether the time ended the search
        self.fitted = dict(self.compared)  # including causes that explain too little
        self.extended: set[tuple[str, ...]] = set()  # causes with all others tried
        self.waiting: list[Finalist] = []
        self.unfitted: list[Finalist] = []  # not fitted for lack of time
        self.noise_ratios: dict[tuple[str, ...], NoiseRatios] = {}

    @property
    def is_complete(self) -> bool:
        """Whether all likely single causes were fitted."""
        if self.is_cut_short and NO_CAUSE not in self.extended:
            return False
        return all(len(each.comparison.causes) > 1 for each in self.unfitted)

    def search(self, tolerance_m: float) -> None:
        """Add effects to the most evident causes while the residual exceeds the noise.

        Each step screens all effects and fits the most evident one. Rivals wait until
        no further effect helps, unless one might explain everything by itself. Then
        effects are added to the next most evident causes. If the best causes leave only
        noise, rivals with as many causes are searched for in the same way.

        tolerance_m: tip misfit that needs no further cause [m].
        """
        while True:
            extendable = self.most_evident_extendable(tolerance_m)
            finalist = self.next_finalist(extendable, tolerance_m)
            if finalist is not None:
                self.fit(finalist)
            elif extendable is None:
                return
            elif self.has_time_to_extend():
                self.add_effect_to(extendable)
            else:
                self.is_cut_short = True
                return

    def has_time_to_extend(self) -> bool:
        """Return whether there is time for a screening and a fit.

        The first screening is always made.
        """
        is_first = len(self.fitted) == 1
        return is_first or not self.budget.is_used_up(screenings=1.0)

    def next_finalist(
        self, extendable: Comparison | None, tolerance_m: float
    ) -> Finalist | None:
        """Choose the finalist to fit next; None to add effects to `extendable` first.

        extendable: most evident causes to which effects may be added.
        tolerance_m: tip misfit that needs no further cause [m].
        """
        self.drop_unlikely_finalists(tolerance_m)
        if not self.waiting:
            return None
        finalist = min(
            self.waiting,
            key=lambda each: (each.is_deferred, -each.comparison.log_evidence),
        )
        best = most_evident_fit(self.compared.values())
        is_best_extendable = extendable is not None and extendable.causes == best.causes
        might_suffice = False
        if not finalist.is_deferred:
            might_suffice = self.might_leave_only_noise(finalist)
        if is_best_extendable and not might_suffice and self.has_time_to_extend():
            return None
        return finalist

    def drop_unlikely_finalists(self, tolerance_m: float) -> None:
        """Drop finalists that can neither become the best causes nor part of them.

        tolerance_m: tip misfit that needs no further cause [m].
        """
        best = most_evident_fit(self.compared.values())
        is_explained = self.is_explained(best, tolerance_m)
        kept = []
        for each in self.waiting:
            evidence = each.comparison.log_evidence
            is_unlikely = (
                each.is_deferred and evidence + MAX_DEFICIT <= best.log_evidence
            )
            has_more_causes = len(each.comparison.causes) > len(best.causes)
            if not is_unlikely and not (is_explained and has_more_causes):
                kept.append(each)
        self.waiting = kept

    def might_leave_only_noise(self, finalist: Finalist) -> bool:
        """Return whether a finalist might leave only noise, within the screening error.

        The log evidence of the screening may be too low by `max_deficit`.
        """
        base = self.comparer.base
        noise = noise_m(self.comparer.observations)
        assert base.estimate is not None
        noise_ratio = min(noise / rms_m(base.estimate), 1.0)
        max_gain = -2 * self.comparer.blocks * np.log(noise_ratio)
        evidence = finalist.comparison.log_evidence
        return bool(evidence + max_deficit(evidence) >= max_gain)

    def add_effect_to(self, base: Comparison) -> None:
        """Screen all effects in addition to causes; the most evident become finalists.

        A slow effect is deferred, unless it is far more evident than the others.
        """
        self.extended.add(base.causes)
        comparer = self.comparer.with_base(base)
        with self.budget.measure_screening():
            screened = self.screen_effects(comparer)
        screened.sort(key=lambda each: -each.comparison.log_evidence)
        finalists = screened[: self.finalists]
        evidence = [each.comparison.log_evidence for each in finalists]
        best = max(evidence, default=0.0)
        gain = best - base.log_evidence
        quick = [each.comparison.log_evidence for each in finalists if not each.is_slow]
        for each in finalists:
            deficit = best - each.comparison.log_evidence
            lead = each.comparison.log_evidence - max(quick, default=-np.inf)
            is_deferred = each.is_slow and lead < MAX_DEFICIT
            if is_deferred or deficit < max_deficit(gain):
                self.waiting.append(replace(each, is_deferred=is_deferred))
        if not base.causes:
            # effects that are not fitted keep the evidence of the coarse mesh
            for each in screened:
                self.compared.setdefault(each.comparison.causes, each.comparison)

    def fit(self, finalist: Finalist) -> None:
        """Fit a finalist; keep it if it explains enough.

        An effect added to causes must explain half of their residual beyond noise.
        """
        comparer, causes = finalist.comparer, finalist.comparison.causes
        base = comparer.base
        self.waiting.remove(finalist)
        if causes not in self.fitted:
            if self.budget.is_used_up(SLOW_FITS if finalist.is_slow else 1.0):
                self.unfitted.append(finalist)
                self.is_cut_short = True
                return
            with self.budget.measure_fit():
                self.fitted[causes] = comparer.fit(finalist.effects, base.estimate)
        noise = noise_m(comparer.observations)
        if not base.causes or explains_half(self.fitted[causes], base, noise):
            self.compared[causes] = self.fitted[causes]

    def screen_effects(self, comparer: Comparer) -> list[Finalist]:
        """Compare each effect added to causes on a coarse mesh.

        Effects are ranked in linear approximation, and the best are refined.
        """
        plain = comparer.screened_square(())
        squares = {}
        for effect in self.effects:
            if effect.name not in comparer.base.causes:
                squares[effect] = comparer.linear_square(effect)
        ranked = sorted(squares, key=lambda effect: squares[effect])
        screened: list[Finalist] = []
        for effect in ranked:
            square = squares[effect]
            if len(screened) < REFINED_EFFECTS:
                square = comparer.screened_square((effect,))
            compared = comparer.comparison((effect,), square / plain)
            screened.append(Finalist((effect,), comparer, compared))
        return screened

    def most_evident_extendable(self, tolerance_m: float) -> Comparison | None:
        """Return the most evident causes to which adding effects may help, if any.

        tolerance_m: tip misfit that needs no further cause [m].
        """
        best = most_evident_fit(self.compared.values())
        nothing = self.compared[NO_CAUSE]
        if NO_CAUSE not in self.extended and not explains_half(best, nothing):
            return nothing  # the causes of earlier trials explain too little
        if not best.causes:
            return None
        is_explained = self.is_explained(best, tolerance_m)
        # if the best causes explain everything, more would not be likelier
        most_causes = len(best.causes) if is_explained else MAX_CAUSES
        candidates = []
        for causes, each in self.compared.items():
            is_extendable = each.estimate is not None and causes not in self.extended
            if causes == NO_CAUSE and is_explained and not self.is_surprising:
                continue  # the causes of earlier trials explain these as well
            if is_extendable and len(causes) < most_causes:
                candidates.append(each)
        return most_evident_fit(candidates) if candidates else None

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
