"""The search of causes: the most evident first, until the budget is used up.

A few iterations on a coarse mesh rank all effects of the library. The most evident are
then fitted. Where the best leaves too much, another effect is sought in addition to it.
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

MAX_CAUSES = 3  # together
SLOW_FITS = 5.0  # others take as long as one with stiff loads
# Of the log evidence on the coarse mesh. What is further behind the best is not fitted:
# a fit from nothing gains less, and others gain as well
MAX_DEFICIT = 15.0
# Of what the best gains, where that is more: of two that fits could not distinguish,
# one was 16 of 61 behind
MAX_DEFICIT_FRACTION = 0.5
# Of the ranking as if effects acted linearly: the causes of string D with three hidden
# ones were at most seventh
REFINED_EFFECTS = 10


def max_deficit(gain: float) -> float:
    """Return by how much the coarse mesh may err where the best effect gains so much.

    Of the log evidence, as the gain.
    """
    return max(MAX_DEFICIT, MAX_DEFICIT_FRACTION * gain)


@dataclass
class Budget:
    """Processor time that may be used.

    Parameters
    ----------
    seconds : how much [s]
    progress : is called with the share that is used
    longest_fit : time that a fit has taken at most [s]
    longest_screening : time that a screening of all effects has taken at most [s]
    """

    seconds: float
    progress: Progress
    longest_fit: float = 0.0
    longest_screening: float = 0.0

    def __post_init__(self) -> None:
        """Begin to count."""
        self.began = time.process_time()

    def is_used_up(self, fits: float = 1.0, screenings: float = 0.0) -> bool:
        """Return whether too little is left for so many; show how much is used."""
        used = time.process_time() - self.began
        self.progress(min(used / max(self.seconds, 1e-9), 1.0))
        needed = fits * self.longest_fit + screenings * self.longest_screening
        return used + needed > self.seconds

    @contextmanager
    def measure_fit(self) -> Iterator[None]:
        """Measure the time of a fit, which the next one may take as well."""
        began = time.process_time()
        yield
        self.longest_fit = max(self.longest_fit, time.process_time() - began)

    @contextmanager
    def measure_screening(self) -> Iterator[None]:
        """Measure the time of a screening, which the next one may take as well."""
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
    comparison : of all on the coarse mesh, or with earlier trials
    waits : whether all others are fitted first
    """

    effects: tuple[type[Effect], ...]
    comparer: Comparer
    comparison: Comparison
    waits: bool = False

    @property
    def is_slow(self) -> bool:
        """Whether some loads are so stiff that a fit takes SLOW_FITS times as long."""
        return any(hasattr(effect, "bound") for effect in self.effects)


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
    is_surprising : bool
        Whether other causes are sought where those of earlier trials explain all.
    """

    comparer: Comparer
    effects: Sequence[type[Effect]]
    compared: dict[tuple[str, ...], Comparison]
    finalists: int
    budget: Budget
    is_surprising: bool = False

    def __post_init__(self) -> None:
        """Begin with nothing searched."""
        self.is_cut_short = False  # whether the time ended the search
        self.fitted = dict(self.compared)  # also causes that explain too little
        self.extended: set[tuple[str, ...]] = set()  # to which all others were added
        self.waiting: list[Finalist] = []
        self.unfitted: list[Finalist] = []  # for which there was no time
        self.noise_ratios: dict[tuple[str, ...], NoiseRatios] = {}

    @property
    def is_complete(self) -> bool:
        """Whether all likely single causes were fitted."""
        if self.is_cut_short and NO_CAUSE not in self.extended:
            return False
        return all(len(each.comparison.causes) > 1 for each in self.unfitted)

    def search(self, tolerance_m: float) -> None:
        """Add effects to the most evident causes while more than noise is left.

        Each of these steps screens all effects and fits the most evident one. Rivals
        wait until no further effect helps, unless one might leave only noise by itself.
        Then effects are added to the next most evident causes. If the best leave only
        noise, rivals of as many causes are sought in the same way.

        tolerance_m: tip misfit that needs no further cause [m].
        """
        while True:
            open_end = self.most_evident_open_end(tolerance_m)
            finalist = self.next_finalist(open_end, tolerance_m)
            if finalist is not None:
                self.fit(finalist)
            elif open_end is None:
                return
            elif self.has_time_to_extend():
                self.add_effect_to(open_end)
            else:
                self.is_cut_short = True
                return

    def has_time_to_extend(self) -> bool:
        """Return whether effects can be screened and one fitted before time is up.

        Effects are screened in any case while no cause is known.
        """
        is_first = len(self.fitted) == 1
        return is_first or not self.budget.is_used_up(screenings=1.0)

    def next_finalist(
        self, open_end: Comparison | None, tolerance_m: float
    ) -> Finalist | None:
        """Choose the effect that is fitted next, before effects are added to causes.

        open_end: causes to which effects may be added.
        tolerance_m: tip misfit that needs no further cause [m].
        """
        self.drop_unlikely_finalists(tolerance_m)
        if not self.waiting:
            return None
        finalist = min(
            self.waiting, key=lambda each: (each.waits, -each.comparison.log_evidence)
        )
        best = most_evident_fit(self.compared.values())
        is_best_open = open_end is not None and open_end.causes == best.causes
        might_suffice = not finalist.waits and self.might_leave_only_noise(finalist)
        if is_best_open and not might_suffice and self.has_time_to_extend():
            return None
        return finalist

    def drop_unlikely_finalists(self, tolerance_m: float) -> None:
        """Drop finalists that cannot become the most evident causes, nor part of them.

        tolerance_m: tip misfit that needs no further cause [m].
        """
        best = most_evident_fit(self.compared.values())
        is_explained = self.is_explained(best, tolerance_m)
        kept = []
        for each in self.waiting:
            evidence = each.comparison.log_evidence
            is_behind = each.waits and evidence + MAX_DEFICIT <= best.log_evidence
            is_longer = len(each.comparison.causes) > len(best.causes)
            if not is_behind and not (is_explained and is_longer):
                kept.append(each)
        self.waiting = kept

    def might_leave_only_noise(self, finalist: Finalist) -> bool:
        """Return whether a finalist might leave only noise, as far as screening says.

        A coarse mesh errs by as much as makes a rival worth a fit.
        """
        nothing = self.comparer.base
        noise = noise_m(self.comparer.observations)
        assert nothing.estimate is not None
        noise_ratio = min(noise / rms_m(nothing.estimate), 1.0)
        most = -2 * self.comparer.blocks * np.log(noise_ratio)
        evidence = finalist.comparison.log_evidence
        return bool(evidence + max_deficit(evidence) >= most)

    def add_effect_to(self, base: Comparison) -> None:
        """Screen all effects in addition to causes; the most evident are finalists.

        A slow effect waits for the others, unless it is far more evident.
        """
        self.extended.add(base.causes)
        comparer = self.comparer.with_base(base)
        with self.budget.measure_screening():
            screened = self.screen_effects(comparer)
        screened.sort(key=lambda each: -each.comparison.log_evidence)
        finalists = screened[: self.finalists]
        evidence = [each.comparison.log_evidence for each in finalists]
        most = max(evidence, default=0.0)
        gain = most - base.log_evidence
        quick = [each.comparison.log_evidence for each in finalists if not each.is_slow]
        for each in finalists:
            behind = most - each.comparison.log_evidence
            ahead = each.comparison.log_evidence - max(quick, default=-np.inf)
            waits = each.is_slow and ahead < MAX_DEFICIT
            if waits or behind < max_deficit(gain):
                self.waiting.append(replace(each, waits=waits))
        if not base.causes:
            # what was not fitted is as evident as it seems on the coarse mesh
            for each in screened:
                self.compared.setdefault(each.comparison.causes, each.comparison)

    def fit(self, finalist: Finalist) -> None:
        """Fit an effect that is added to causes; keep it if it explains enough.

        Where there are causes already, it must explain half of what they leave beyond
        noise.
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
        """Compare each effect that is added to causes on a coarse mesh.

        The best of those that are compared as if they acted linearly are refined.
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

    def most_evident_open_end(self, tolerance_m: float) -> Comparison | None:
        """Return the most evident causes to which no effect was added, if it may help.

        tolerance_m: tip misfit that needs no further cause [m].
        """
        best = most_evident_fit(self.compared.values())
        nothing = self.compared[NO_CAUSE]
        if NO_CAUSE not in self.extended and not explains_half(best, nothing):
            return nothing  # what earlier trials showed is of little help
        if not best.causes:
            return None
        is_explained = self.is_explained(best, tolerance_m)
        # more causes would be no likelier then
        most_causes = len(best.causes) if is_explained else MAX_CAUSES
        open_ends = []
        for causes, each in self.compared.items():
            is_open = each.estimate is not None and causes not in self.extended
            if causes == NO_CAUSE and is_explained and not self.is_surprising:
                continue  # causes of earlier trials explain these, too
            if is_open and len(causes) < most_causes:
                open_ends.append(each)
        return most_evident_fit(open_ends) if open_ends else None

    def is_explained(self, comparison: Comparison, tolerance_m: float) -> bool:
        """Return whether fitted causes leave little, and nothing but noise.

        tolerance_m: tip misfit that matters little [m].
        """
        if not comparison.causes or not self.is_near(comparison, tolerance_m):
            return False
        return self.noise_ratios_of(comparison).explain_all

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
