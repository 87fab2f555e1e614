"""The quick comparison of causes: the most evident first, until the budget is used up.

A few iterations on a coarse mesh rank all effects of the library. The most evident are
then fitted as from nothing: a cause that moves much, such as a heavy tip, moves the
other parameters along, so that a fit that begins nearby may end nearby. Where the best
leaves too much, another effect is sought in addition to it.

The evidence is that of the Bayesian information criterion (Schwarz 1978) for
independent blocks of time. A diagnosis compares more carefully and takes minutes.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated

import numpy as np
import pandas as pd
from pydantic import Field

from stringcast.data.artifacts import (
    EXPLANATION_SUMMARY,
    EXPLANATIONS,
    Estimate,
    Explanation,
    Observation,
)
from stringcast.stages.common import MM_PER_M, Progress, describe_causes, rms
from stringcast.stages.diagnose.probabilities import (
    PRIOR_NO_EFFECT,
    effect_probabilities,
)
from stringcast.stages.diagnose.proposals import candidate_effects
from stringcast.stages.estimate.least_squares import estimate as fit_from_nothing
from stringcast.stages.estimate.matching import Matching
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.likelihood import Likelihood, time_blocks
from stringcast.stages.inference.mesh import (
    discretisation_error,
    mesh_ladder,
    resolved_frames,
    with_corrected_points,
)
from stringcast.stages.inference.prepared_trial import prepare_trial
from stringcast.stages.inference.search import with_estimated_noise
from stringcast.stages.inference.solver import fit_least_squares
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.effect import Effect
from stringcast.stages.model.extension import extend_model
from stringcast.stages.model.library import effects_by_name, find_effects
from stringcast.stages.model.model import Model

NAMED_PROBABILITY = 0.9  # of causes that are named alone
MIXED_PROBABILITY = 0.05  # of causes whose draws the next plan uses
MIN_EXPLAINED_FRACTION = 0.5  # of the mean square misfit, by a cause that is named
# Of the residual to the noise, where causes are named: right ones leave 1.00 to 1.05,
# others, which stand in for two of three causes, 1.18 to 1.21
MAX_NOISE_RATIO = 1.1
# Of the error of the mesh to the noise. A quarter of it may be left after correction.
MAX_MESH_ERROR_RATIO = 1.0
MAX_CAUSES = 3  # together
SLOW_FITS = 5.0  # others take as long as one with stiff loads
# Of the log evidence on the coarse mesh. What is further behind is not fitted: a fit
# from nothing gains less, and others gain as well
MAX_DEFICIT = 15.0
PROBE_FRACTIONS = (0.01, 0.03, 0.1, 0.3)  # of the way from absent to an amplitude
PROBES = 16
SCREENED_PROBES = 3  # the best of them, which are refined
SCREENING_ITERATIONS = 8  # at most
# Of the log evidence. Runs that promise less end; with 0.05 some ended on a plateau
SCREENING_MIN_GAIN = 0.005
CORRECTION_PASSES = 3
COARSE_LEVEL = 2  # of the mesh, halvings
NO_CAUSE: tuple[str, ...] = ()
TIME_IS_UP = "the processor time was used up before all likely causes were fitted"


@dataclass(frozen=True)
class Comparison:
    """Comparison of some causes, or none, with the trials.

    Parameters
    ----------
    causes : names of the effects; empty for the model as it was
    log_evidence : gain over the model as it was
    estimate : of the model with the causes, where it was fitted from nothing
    """

    causes: tuple[str, ...]
    log_evidence: float
    estimate: Estimate | None = None


@dataclass(frozen=True)
class NoiseRatios:
    """Residuals over the noise where the mesh resolves the string; 1 for noise alone.

    Parameters
    ----------
    without : of the model as it was
    left : of the model with causes
    """

    without: float
    left: float

    @property
    def are_noise(self) -> bool:
        """Whether nothing but noise is left."""
        return self.left < MAX_NOISE_RATIO

    @property
    def explain_half(self) -> bool:
        """Whether the causes explain half of the mean square misfit."""
        return (self.left / self.without) ** 2 <= 1 - MIN_EXPLAINED_FRACTION

    @property
    def explain_all(self) -> bool:
        """Whether the causes explain the misfit and leave nothing but noise."""
        return self.are_noise and self.explain_half


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
        """Tell whether too little is left for so many fits; show how much is used."""
        used = time.process_time() - self.began
        self.progress(min(used / max(self.seconds, 1e-9), 1.0))
        return used + fits * self.longest_fit > self.seconds

    @contextmanager
    def measure_fit(self) -> Iterator[None]:
        """Measure the time of a fit, which the next one may take as well."""
        began = time.process_time()
        yield
        self.longest_fit = max(self.longest_fit, time.process_time() - began)


def explain(
    model: Model,
    observations: Sequence[Observation],
    estimate: Estimate,
    previous: Explanation | None,
    is_surprising: bool,
    tolerance_m: float,
    *,
    seed: int,
    manipulation: Annotated[int, Field(ge=1)],
    seconds: Annotated[float, Field(ge=0)],
    finalists: Annotated[int, Field(ge=1)],
    starts: Annotated[int, Field(ge=1)],
    screening: Annotated[int, Field(ge=1)],
    iterations: Annotated[int, Field(ge=1)],
    matching: Matching,
    progress: Progress = lambda share: None,
) -> Explanation:
    """Find the causes of trials that surprise or that the estimate does not explain.

    Parameters
    ----------
    model : Model
        Without the causes.
    observations : sequence of Observation
        The trials.
    estimate : Estimate
        Of the model from these trials.
    previous : Explanation or None
        Of earlier trials; its causes are fitted first.
    is_surprising : bool
        Whether the last trial was not within what was predicted.
    tolerance_m : float
        Tip misfit that does not matter [m].
    seed, manipulation : int
        Of the random starts.
    seconds : float
        Processor time after which no further cause is fitted [s].
    finalists : int
        Number of the most evident causes, which are fitted as if nothing were known.
    starts, screening, iterations, matching
        Of such a fit, as of `least_squares.estimate`.
    progress : callable
        Called with the share of the budget that is used.

    Returns
    -------
    Explanation
        The estimate that the next plan uses, with causes and their probabilities.
    """
    budget = Budget(seconds, progress)
    earlier = [] if previous is None else earlier_causes(previous)
    if not is_surprising and not earlier:
        if tip_rms_m(estimate) <= tolerance_m:
            return not_asked(estimate, "The model explains the trials")
        if is_error_of_mesh(model, observations, estimate):
            return not_asked(estimate, "The model leaves the error of its mesh")

    trials = [prepare_trial(model, observation) for observation in observations]
    effects = candidate_effects(model, effects_by_name(), trials)
    blocks = int(time_blocks(trials).max()) + 1
    base = Comparison(NO_CAUSE, 0.0, estimate)
    fit_model = partial(
        fit_from_nothing,
        seed=seed,
        manipulation=manipulation,
        starts=starts,
        screening=screening,
        iterations=iterations,
        matching=matching,
    )
    compare = Comparer(model, observations, base, blocks, fit_model, seed)
    compared = {NO_CAUSE: base}
    for causes in earlier:
        is_best = previous is not None and causes == next(iter(previous.cause_sets))
        start = previous if is_best else estimate
        with budget.measure_fit():
            compared[causes] = compare.fit(find_effects(causes), start)
    fitted = list(compared.values())
    is_enough = any(tip_rms_m(each.estimate) <= tolerance_m for each in fitted)

    search = CauseSearch(compare, effects, compared, finalists, budget)
    if is_surprising or not is_enough:
        search.add_effect_to(base)
    search.add_further_effects(tolerance_m)
    probabilities = posterior_probabilities(compared, len(effects))
    best = compared[next(iter(probabilities))]
    explaining = best if explains_half(best, base) else base
    noise_ratios = search.with_noise(explaining)
    # with three effects, false ones may fit a few trials: others are compared first
    is_checked = not search.is_cut_short or best.causes in earlier
    verdict, sentence = decide(
        compared,
        probabilities,
        tolerance_m,
        search.is_complete,
        noise_ratios,
        is_checked or len(best.causes) == 1,
    )
    finding = {
        "verdict": verdict,
        "candidates": len(effects),
        "fitted": sum(each.estimate is not None for each in compared.values()) - 1,
        "sentence": sentence,
        "rms_without": rms_m(estimate),
    }
    if verdict == "none":
        compared = {NO_CAUSE: base}
        probabilities = {NO_CAUSE: 1.0}
    return build_explanation(model, compared, probabilities, finding, seed)


def earlier_causes(previous: Explanation) -> list[tuple[str, ...]]:
    """List the causes that are fitted first: those that were likely.

    If none was named, the most evident others that were fitted are among them. An
    effect that is added to these may explain more than the likely ones.
    """
    likely = []
    for causes, probability in previous.cause_sets.items():
        if causes and probability >= MIXED_PROBABILITY:
            likely.append(causes)
    if not likely or previous.named_causes:
        return likely
    is_fitted = previous.explanations["fitted"].to_numpy(dtype=bool)
    for causes, was_fitted in zip(previous.cause_sets, is_fitted, strict=True):
        if was_fitted and causes and causes not in likely:
            return [*likely, causes]
    return likely


@dataclass(frozen=True)
class Comparer:
    """Compare effects that are added to a model, by the same trials.

    Parameters
    ----------
    model : Model
        With the causes that were found before, if any.
    observations : sequence of Observation
        The trials.
    base : Comparison
        Of this model with the trials, fitted.
    blocks : int
        Number of independent blocks of time in the trials.
    fit_model : callable
        Fits a model to observations, also from an earlier estimate, if there is one.
    seed : int
        Of the sizes at which effects are tried.
    """

    model: Model
    observations: Sequence[Observation]
    base: Comparison
    blocks: int
    fit_model: Callable[[Model, Sequence[Observation], Estimate | None], Estimate]
    seed: int

    def given(self, base: Comparison) -> Comparer:
        """Return the comparison of effects that are added to causes."""
        extended = self.model.with_effects(*find_effects(base.causes))
        return replace(self, model=extended, base=base)

    def comparison(
        self,
        effects: Sequence[type[Effect]],
        square_ratio: float,
        estimate: Estimate | None = None,
    ) -> Comparison:
        """Compare effects by a mean square that falls to a ratio of the base's."""
        gain = self.blocks * -np.log(max(square_ratio, np.finfo(float).tiny))
        added = sum(len(effect.parameters) for effect in effects)
        evidence = gain - 0.5 * added * np.log(self.blocks)
        causes = [*self.base.causes, *(effect.name for effect in effects)]
        return Comparison(
            tuple(sorted(causes)), self.base.log_evidence + float(evidence), estimate
        )

    def screened_square(self, effects: Sequence[type[Effect]]) -> float:
        """Compute the mean square that a few iterations leave on a coarse mesh.

        They begin at the best of some sizes of the last effect.
        """
        assert self.base.estimate is not None
        hypothesis = Hypothesis(self.model, tuple(effects))
        trials = [prepare_trial(hypothesis.model, o) for o in self.observations]
        likelihood = Likelihood(TrialData(tuple(trials)), hypothesis.model)
        ladder = mesh_ladder(likelihood)
        coarse = ladder[min(COARSE_LEVEL, len(ladder) - 1)]
        fitted = self.base.estimate.parameters
        exponents = dict(zip(fitted["name"], fitted["chi"], strict=True))
        start = hypothesis.exponents_from(exponents)
        coarse = with_estimated_noise(coarse, start)

        starts = start[None]
        if effects:
            probes = self._probes(hypothesis, effects[-1], start)
            squares = np.mean(coarse.residuals(probes) ** 2, axis=1)
            starts = probes[np.argsort(squares, kind="stable")[:SCREENED_PROBES]]
        # the solver takes each number as independent, and the evidence each block
        numbers = sum(2 * len(trial.s) for trial in trials)
        min_gain = SCREENING_MIN_GAIN * numbers / (2 * self.blocks)
        runs = fit_least_squares(coarse, starts, SCREENING_ITERATIONS, min_gain)
        return float(np.mean(runs.residual[np.argmin(runs.loss)] ** 2))

    def _probes(
        self, hypothesis: Hypothesis, effect: type[Effect], start: np.ndarray
    ) -> np.ndarray:
        """Choose exponents (C, P) at which an effect acts, near the estimate."""
        rng = np.random.default_rng([self.seed, PROBES])
        own = hypothesis.parameter_indices(effect, effect.parameters)
        amplitudes = hypothesis.amplitude_indices(effect)
        probes = np.tile(start, (PROBES, 1))
        probes[:, own] = rng.uniform(0, 1, (PROBES, len(own)))
        # half of them to either end of the range of the first amplitude
        probes[::2, amplitudes[0]] = 0.0
        probes[1::2, amplitudes[0]] = 1.0
        fractions = np.repeat(PROBE_FRACTIONS, PROBES // len(PROBE_FRACTIONS))[:, None]
        distance = probes[:, amplitudes] - start[amplitudes]
        probes[:, amplitudes] = start[amplitudes] + fractions * distance
        return probes

    def fit(
        self, effects: Sequence[type[Effect]], start: Estimate | None
    ) -> Comparison:
        """Fit the model with effects as if nothing were known, and from a start."""
        base = self.base.estimate
        assert base is not None
        extended = self.model.with_effects(*effects)
        made = self.fit_model(extended, self.observations, start)
        return self.comparison(effects, (rms_m(made) / rms_m(base)) ** 2, made)


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
        comparer = self.comparer.given(base)
        screened = self.screen_effects(comparer)
        screened.sort(key=lambda each: -each.comparison.log_evidence)
        finalists = screened[: self.finalists]
        quick = [each.comparison.log_evidence for each in finalists if not each.is_slow]
        for each in finalists:
            evidence = each.comparison.log_evidence
            if each.is_slow and evidence < max(quick, default=-np.inf) + MAX_DEFICIT:
                self.postponed.append((comparer, each))
            elif evidence + MAX_DEFICIT > finalists[0].comparison.log_evidence:
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
        is_near = tip_rms_m(best.estimate) <= tolerance_m
        is_explained = is_near and self.with_noise(best).explain_all
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

    def with_noise(self, comparison: Comparison) -> NoiseRatios:
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


def compare_with_noise(
    model: Model, observations: Sequence[Observation], estimates: Sequence[Estimate]
) -> NoiseRatios:
    """Compare what estimates without and with causes leave with the noise.

    The end of a trial does not count if the mesh of one of them errs by more than the
    noise there. False parameters without causes may err so much that hardly anything
    counts. So nothing more may be left where the model with causes is resolved.
    """
    without, left = resolved_residuals(model, observations, estimates)
    (left_alone,) = resolved_residuals(model, observations, estimates[1:])
    return NoiseRatios(without, max(left, left_alone))


def resolved_residuals(
    model: Model, observations: Sequence[Observation], estimates: Sequence[Estimate]
) -> list[float]:
    """Compute the residual over the noise of each estimate, where all are resolved."""
    fits = [likelihood_at(model, observations, estimate) for estimate in estimates]
    counts = [resolved_frames(*fit, MAX_MESH_ERROR_RATIO) for fit in fits]
    frames = np.min(counts, axis=0)  # of each trial
    residuals = []
    for likelihood, chi in fits:
        pairs = zip(likelihood.data.trials, frames, strict=True)
        resolved = [trial.first_frames(int(count)) for trial, count in pairs]
        residuals.append(corrected_residual(likelihood.with_trials(resolved), chi))
    return residuals


def likelihood_at(
    model: Model, observations: Sequence[Observation], estimate: Estimate
) -> tuple[Likelihood, np.ndarray]:
    """Return the likelihood of the model of an estimate, and its exponents (P,)."""
    extended = extend_model(model, estimate.values())
    trials = [prepare_trial(extended, observation) for observation in observations]
    fitted = estimate.parameters.set_index("name")["chi"]
    chi = fitted.loc[list(extended.names)].to_numpy()
    return Likelihood(TrialData(tuple(trials)), extended), chi


def is_error_of_mesh(
    model: Model, observations: Sequence[Observation], estimate: Estimate
) -> bool:
    """Tell whether an estimate leaves only noise and the error of the mesh.

    Only noise is left where the mesh resolves the string, and the error of the mesh
    explains half of the mean square misfit of the whole trials.
    """
    misfit = rms_m(estimate) ** 2 - noise_m(observations) ** 2
    error_m = discretisation_error(*likelihood_at(model, observations, estimate))
    if not error_m**2 >= MIN_EXPLAINED_FRACTION * misfit:
        return False
    (residual,) = resolved_residuals(model, observations, [estimate])
    return residual < MAX_NOISE_RATIO


def corrected_residual(likelihood: Likelihood, chi: np.ndarray) -> float:
    """Compute the residual over sigma without the error of the mesh.

    That error is subtracted, and the parameters (P,), which compensated for it, are
    fitted again, in turn. The least residual counts: with friction the error of a
    string that is fitted well is hardly known.
    """
    least = rms(likelihood.residuals(chi[None])[0])
    for _ in range(CORRECTION_PASSES):
        corrected = with_corrected_points(likelihood, chi)
        runs = fit_least_squares(corrected, chi[None], SCREENING_ITERATIONS)
        chi = runs.chi[0]
        least = min(least, rms(runs.residual[0]))
    return least


def rms_m(estimate: Estimate) -> float:
    """Return the residual of the centre-line, root mean square [m]."""
    return float(estimate.fit["rms_after"].iloc[0])


def tip_rms_m(estimate: Estimate | None) -> float:
    """Return the residual of the tip, root mean square [m]; NaN without a fit."""
    return np.nan if estimate is None else float(estimate.fit["tip_after"].iloc[0])


def most_evident_fit(compared: Iterable[Comparison]) -> Comparison:
    """Return the most evident comparison among those that were fitted."""
    fitted = [each for each in compared if each.estimate is not None]
    return max(fitted, key=lambda each: each.log_evidence)


def noise_m(observations: Sequence[Observation]) -> float:
    """Return the distance by which noise alone moves a measured point [m]."""
    sigma = pd.concat([observation.points["sigma"] for observation in observations])
    return float(np.sqrt(2) * sigma.median())


def explains_half(each: Comparison, base: Comparison, noise_m: float = 0.0) -> bool:
    """Tell whether causes that were fitted explain half of the mean square misfit.

    noise_m: residual that no cause explains, root mean square [m].
    """
    if each.estimate is None or base.estimate is None:
        return False
    misfit = rms_m(base.estimate) ** 2 - noise_m**2
    left = rms_m(each.estimate) ** 2 - noise_m**2
    return left <= (1 - MIN_EXPLAINED_FRACTION) * misfit


def posterior_probabilities(
    compared: Mapping[tuple[str, ...], Comparison], candidates: int
) -> dict[tuple[str, ...], float]:
    """Compute the probability of all compared causes, the most probable first.

    Effects are active independently of each other before the trials.
    """
    prior_odds = (1 - PRIOR_NO_EFFECT) / candidates / PRIOR_NO_EFFECT
    log_evidence = {}
    for causes, each in compared.items():
        # that of one cause is counted in any case
        further = max(len(causes) - 1, 0) * np.log(prior_odds)
        log_evidence[causes] = np.array([each.log_evidence + further])
    probabilities = effect_probabilities(log_evidence, candidates)
    ranked = sorted(probabilities, key=lambda causes: -probabilities[causes])
    return {causes: probabilities[causes] for causes in ranked}


def decide(
    compared: Mapping[tuple[str, ...], Comparison],
    probabilities: Mapping[tuple[str, ...], float],
    tolerance_m: float,
    is_complete: bool,
    noise_ratios: NoiseRatios,
    is_checked: bool = True,
) -> tuple[str, str]:
    """Decide the verdict, and state it in words.

    noise_ratios: of the most probable causes if they explain half of the misfit, else
    of no cause. is_checked: whether rivals of these causes were sought, or earlier
    trials showed them.
    """
    base = compared[NO_CAUSE]
    assert base.estimate is not None
    best = compared[next(iter(probabilities))]
    if best.causes and explains_half(best, base):
        return _decide_about(
            best,
            base,
            probabilities,
            tolerance_m,
            is_complete,
            noise_ratios,
            is_checked,
        )
    if not is_complete:
        return "undecided", f"No cause was found; {TIME_IS_UP}."
    base_mm = MM_PER_M * tip_rms_m(base.estimate)
    if tip_rms_m(base.estimate) > tolerance_m:
        return (
            "unknown",
            f"No single effect explains why the tip is {base_mm:.1f} mm off.",
        )
    if not noise_ratios.are_noise:
        return "unknown", "No single effect explains why more than noise is left."
    return (
        "none",
        "No cause is needed: the model leaves only noise where it is resolved.",
    )


def _decide_about(
    best: Comparison,
    base: Comparison,
    probabilities: Mapping[tuple[str, ...], float],
    tolerance_m: float,
    is_complete: bool,
    noise_ratios: NoiseRatios,
    is_checked: bool,
) -> tuple[str, str]:
    """Decide whether the most probable causes, which explain much, are named."""
    left_mm = MM_PER_M * tip_rms_m(best.estimate)
    base_mm = MM_PER_M * tip_rms_m(base.estimate)
    name = describe_causes(best.causes)
    effect = f"With {name} the tip is {left_mm:.1f} mm off instead of {base_mm:.1f}"
    is_explained = tip_rms_m(best.estimate) <= tolerance_m
    if not is_complete and not is_explained:
        return "undecided", f"{effect}; {TIME_IS_UP}."
    probability = probabilities[best.causes]
    if probability < NAMED_PROBABILITY:
        others = []
        for causes, p in probabilities.items():
            if p >= MIXED_PROBABILITY:
                others.append(f"{describe_causes(causes)} ({p:.2f})")
        return "candidates", f"{effect}, but others may act: {', '.join(others)}."
    effect += f" (probability {probability:.2f})"
    if not is_explained:
        return "partial", f"{effect}; something else is left."
    doubt = ""
    if not noise_ratios.are_noise:
        doubt = "more than noise is left: others may act"
    elif not noise_ratios.explain_half:
        doubt = "not where the mesh resolves the string"
    elif not is_checked:
        doubt = TIME_IS_UP
    if doubt:
        return "candidates", f"{effect}, but {doubt}."
    return "cause", f"{effect}."


def not_asked(estimate: Estimate, reason: str) -> Explanation:
    """Return the estimate without causes: nothing needs an explanation."""
    finding = {
        "verdict": "not asked",
        "candidates": 0,
        "fitted": 0,
        "sentence": f"{reason}; no cause was sought.",
    }
    table = EXPLANATION_SUMMARY.check(pd.DataFrame([finding]))
    return Explanation(**estimate_tables(estimate), finding=table)


def estimate_tables(estimate: Estimate) -> dict[str, pd.DataFrame]:
    """Return the tables of an estimate by the names of its fields."""
    return {name: getattr(estimate, name) for name in Estimate.TABLES}


def build_explanation(
    model: Model,
    compared: Mapping[tuple[str, ...], Comparison],
    probabilities: Mapping[tuple[str, ...], float],
    finding: Mapping[str, object],
    seed: int,
) -> Explanation:
    """Build the artifact from the most probable fit and draws of all probable ones."""
    mixed: dict[tuple[str, ...], tuple[float, Estimate]] = {}
    for causes, probability in probabilities.items():
        fit = compared[causes].estimate
        if fit is not None and (probability >= MIXED_PROBABILITY or not mixed):
            mixed[causes] = probability, fit
    best = next(iter(mixed.values()))[1]
    names = dict.fromkeys(name for causes in mixed for name in causes)
    estimate = with_absent_effects(model, best, list(names))
    draws = mix_draws(mixed, estimate, seed)

    rows = []
    for causes, probability in probabilities.items():
        each = compared[causes]
        rows.append(
            {
                "effects": " ".join(causes),
                "probability": probability,
                "log_evidence": each.log_evidence,
                "tip_rms": tip_rms_m(each.estimate),
                "fitted": each.estimate is not None,
            }
        )
    return Explanation(
        **estimate_tables(replace(estimate, draws=draws)),
        explanations=EXPLANATIONS.check(pd.DataFrame(rows)),
        finding=EXPLANATION_SUMMARY.check(pd.DataFrame([finding])),
    )


def with_absent_effects(
    model: Model, estimate: Estimate, names: Sequence[str]
) -> Estimate:
    """Add the parameters of effects that are absent from an estimate."""
    known = set(estimate.parameters["name"])
    rows = [estimate.parameters]
    candidates = estimate.candidates
    for effect in find_effects(names):
        if known >= {effect.qualified_name(p) for p in effect.parameters}:
            continue
        extended = model.with_effects(effect)
        for parameter in extended.parameters:
            if parameter.name in known:
                continue
            row = {
                "name": parameter.name,
                "symbol": parameter.symbol,
                "unit": parameter.unit,
                "meaning": parameter.meaning,
                "value": parameter.start,
                "low": np.nan,
                "high": np.nan,
                "minimum": parameter.low,
                "maximum": parameter.high,
                "chi": float(parameter.chi(np.asarray(parameter.start))),
                "at_bound": False,
                "determined": False,
            }
            rows.append(pd.DataFrame([row]))
            candidates = candidates.assign(**{parameter.name: parameter.start})
    parameters = pd.concat(rows, ignore_index=True)
    return replace(estimate, parameters=parameters, candidates=candidates)


def mix_draws(
    mixed: Mapping[tuple[str, ...], tuple[float, Estimate]], whole: Estimate, seed: int
) -> pd.DataFrame:
    """Draw from several estimates as often as each is probable.

    Parameters that an estimate does not have are where their effect is absent.
    """
    absent = whole.values()
    for causes, (_, fit) in mixed.items():
        known = fit.values()
        for effect in find_effects(causes):
            for parameter in effect.parameters:
                qualified = effect.qualified_name(parameter)
                if qualified in known:
                    absent[qualified] = parameter.start
    weights = np.array([probability for probability, _ in mixed.values()])
    count = len(whole.draws)
    rng = np.random.default_rng([seed, count])
    chosen = rng.choice(len(mixed), count, p=weights / weights.sum())
    parts = []
    for number, (_, fit) in enumerate(mixed.values()):
        wanted = int((chosen == number).sum())
        rows = rng.integers(0, len(fit.draws), wanted)
        part = fit.draws.iloc[rows]
        missing = {
            name: value for name, value in absent.items() if name not in part.columns
        }
        parts.append(part.assign(**missing))
    draws = pd.concat(parts, ignore_index=True)[["draw", *absent]]
    return draws.assign(draw=np.arange(len(draws)))
