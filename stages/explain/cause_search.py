"""The search of causes: the most evident first, until the budget is used up.

A few iterations on a coarse mesh rank all effects of the library. The most evident are
then fitted. Where the best leaves too much, another effect is sought in addition to it.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from stringcast.stages.common import Progress
from stringcast.stages.explain.comparison import (
    NO_CAUSE,
    Comparer,
    Comparison,
    explains_half,
    most_evident_fit,
    noise_m,
    tip_rms_m,
)
from stringcast.stages.explain.noise_ratios import NoiseRatios, compare_with_noise
from stringcast.stages.model.effect import Effect

MAX_CAUSES = 3  # together
SLOW_FITS = 5.0  # others take as long as one with stiff loads
# Of the log evidence on the coarse mesh. What is further behind the best is not fitted:
# a fit from nothing gains less, and others gain as well
MAX_DEFICIT = 15.0
# Of what the best gains, where that is more: of two that fits could not distinguish,
# one was 16 of 61 behind
MAX_DEFICIT_FRACTION = 0.5


@dataclass
class Budget:
    """Processor time that may be used.

    Parameters
    ----------
    seconds : how much [s]
    progress : is called with the share that is used
    longest_fit : time that a fit has taken at most [s]
    """

    seconds: float
    progress: Progress
    longest_fit: float = 0.0

    def __post_init__(self) -> None:
        """Begin to count."""
        self.began = time.process_time()

    def is_used_up(self, fits: float = 1.0) -> bool:
        """Return whether too little is left for so many fits; show how much is used."""
        used = time.process_time() - self.began
        self.progress(min(used / max(self.seconds, 1e-9), 1.0))
        return used + fits * self.longest_fit > self.seconds

    @contextmanager
    def measure_fit(self) -> Iterator[None]:
        """Measure the time of a fit, which the next one may take as well."""
        began = time.process_time()
        yield
        self.longest_fit = max(self.longest_fit, time.process_time() - began)


@dataclass(frozen=True)
class Finalist:
    """An effect that may be fitted, and its comparison on the coarse mesh."""

    effect: type[Effect]
    comparison: Comparison

    @property
    def is_slow(self) -> bool:
        """Whether its loads are so stiff that a fit takes SLOW_FITS times as long."""
        return hasattr(self.effect, "bound")


@dataclass
class CauseSearch:
    """Search of causes: each effect is added to the most evident ones.

    Parameters
    ----------
    comparer : Comparer
        Compares effects that are added to the model as it was.
    effects : sequence of Effect types
        That may act.
    compared : dict
        All comparisons by their causes. The search adds to them.
    finalists : int
        Number of the most evident causes that are fitted as if nothing were known.
    budget : Budget
        Processor time that may be used.
    """

    comparer: Comparer
    effects: Sequence[type[Effect]]
    compared: dict[tuple[str, ...], Comparison]
    finalists: int
    budget: Budget

    def __post_init__(self) -> None:
        """Begin with nothing searched."""
        self.is_complete = True  # whether all likely causes were fitted
        self.is_cut_short = False  # whether the time ended a search of further causes
        self.fitted = dict(self.compared)  # also causes that explain too little
        self.extended: set[tuple[str, ...]] = set()  # to which all others were added
        self.postponed: list[tuple[Comparer, Finalist]] = []
        self.noise_ratios: dict[tuple[str, ...], NoiseRatios] = {}

    def add_effect_to(self, base: Comparison) -> None:
        """Screen all effects in addition to causes, and fit the most evident ones.

        Where there are causes already, another must explain half of what they leave
        beyond noise. A slow effect waits until the most evident one has been extended,
        unless it is far more evident than the quick ones.
        """
        self.extended.add(base.causes)
        comparer = self.comparer.with_base(base)
        screened = self.screen_effects(comparer)
        screened.sort(key=lambda each: -each.comparison.log_evidence)
        finalists = screened[: self.finalists]
        quick = [each.comparison.log_evidence for each in finalists if not each.is_slow]
        most = max((each.comparison.log_evidence for each in finalists), default=0.0)
        gain = most - base.log_evidence
        max_deficit = max(MAX_DEFICIT, MAX_DEFICIT_FRACTION * gain)
        for each in finalists:
            evidence = each.comparison.log_evidence
            if each.is_slow and evidence < max(quick, default=-np.inf) + MAX_DEFICIT:
                self.postponed.append((comparer, each))
            elif evidence + max_deficit > most:
                self.fit(comparer, each)
        if not base.causes:
            # what was not fitted is as evident as it seems on the coarse mesh
            for each in screened:
                self.compared.setdefault(each.comparison.causes, each.comparison)

    def fit(self, comparer: Comparer, finalist: Finalist) -> None:
        """Fit an effect that is added to causes; keep it if it explains enough."""
        base, causes = comparer.base, finalist.comparison.causes
        if causes not in self.fitted:
            if self.budget.is_used_up(SLOW_FITS if finalist.is_slow else 1.0):
                self.is_complete = self.is_complete and bool(base.causes)
                self.is_cut_short = True
                return
            with self.budget.measure_fit():
                self.fitted[causes] = comparer.fit((finalist.effect,), base.estimate)
        noise = noise_m(comparer.observations)
        if not base.causes or explains_half(self.fitted[causes], base, noise):
            self.compared[causes] = self.fitted[causes]

    def screen_effects(self, comparer: Comparer) -> list[Finalist]:
        """Compare each effect that is added to causes on a coarse mesh.

        Returns none if the time is up, so that no fit of a further cause would begin.
        """
        plain = comparer.screened_square(())
        screened = []
        for effect in self.effects:
            if self.budget.is_used_up() and comparer.base.causes:
                self.is_cut_short = True
                return []
            if effect.name not in comparer.base.causes:
                square_ratio = comparer.screened_square((effect,)) / plain
                compared = comparer.comparison((effect,), square_ratio)
                screened.append(Finalist(effect, compared))
        return screened

    def add_further_effects(self, tolerance_m: float) -> None:
        """Add effects to the most evident causes while more than noise is left.

        Then effects are added to the next most evident ones. If the best leave only
        noise, rivals of as many causes are sought in the same way.

        tolerance_m: tip misfit that needs no further cause [m].
        """
        while not self.budget.is_used_up():
            open_end = self.most_evident_open_end(tolerance_m)
            if open_end is None and not self.postponed:
                return
            if open_end is not None:
                self.add_effect_to(open_end)
            self.fit_postponed()
        self.fit_postponed()
        if self.most_evident_open_end(tolerance_m) is not None:
            self.is_cut_short = True

    def most_evident_open_end(self, tolerance_m: float) -> Comparison | None:
        """Return the most evident causes to which no effect was added, if it may help.

        tolerance_m: tip misfit that needs no further cause [m].
        """
        best = most_evident_fit(self.compared.values())
        if not best.causes:
            return None
        is_near = self.is_near(best, tolerance_m)
        is_explained = is_near and self.noise_ratios_of(best).explain_all
        # more causes would be no likelier then
        most_causes = len(best.causes) if is_explained else MAX_CAUSES
        open_ends = []
        for causes, each in self.compared.items():
            is_open = each.estimate is not None and causes not in self.extended
            if causes == NO_CAUSE and is_explained:
                continue  # causes of earlier trials explain these, too
            if is_open and len(causes) < most_causes:
                open_ends.append(each)
        return most_evident_fit(open_ends) if open_ends else None

    def fit_postponed(self) -> None:
        """Fit the slow effects that were postponed, where they may still be likely."""
        for comparer, finalist in self.postponed:
            best = most_evident_fit(self.compared.values())
            if finalist.comparison.log_evidence + MAX_DEFICIT > best.log_evidence:
                self.fit(comparer, finalist)
        self.postponed.clear()

    def is_near(self, comparison: Comparison, tolerance_m: float) -> bool:
        """Return whether fitted causes leave little, or only the mesh's error.

        tolerance_m: tip misfit that matters little [m].
        """
        if tip_rms_m(comparison.estimate) <= tolerance_m:
            return True
        return self.noise_ratios_of(comparison).leave_mesh_error

    def noise_ratios_of(self, comparison: Comparison) -> NoiseRatios:
        """Compare what causes that were fitted leave with the noise."""
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
