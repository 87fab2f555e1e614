"""Compare causes with trials: on a coarse mesh, and by fits from new starts.

A strong cause, such as a heavy tip, shifts the other parameters, so that a fit from the
old optimum may end in a local minimum. The evidence is that of the Bayesian information
criterion (Schwarz 1978) for independent blocks of time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import pandas as pd

from stringcast.data.artifacts import Observation
from stringcast.data.estimates import Estimate
from stringcast.stages.common import rms
from stringcast.stages.inference.covariance import linearise
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.likelihood import Likelihood
from stringcast.stages.inference.mesh import (
    REFERENCE_REFINEMENT,
    likelihood_on_mesh,
    mesh_ladder,
    with_corrected_points,
)
from stringcast.stages.inference.prepared_trial import (
    PreparedTrial,
    prepare_trial,
    with_model,
)
from stringcast.stages.inference.search import with_estimated_noise
from stringcast.stages.inference.solver import (
    fit_least_squares,
    minimise_in_box,
    with_flat_curvature,
)
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.effect import Effect
from stringcast.stages.model.library import find_effects
from stringcast.stages.model.model import Model

NO_CAUSE: tuple[str, ...] = ()
MIN_EXPLAINED_FRACTION = 0.5  # of the mean square misfit, for a cause to be named
PROBE_FRACTIONS = (0.01, 0.03, 0.1, 0.3)  # of the distance from absent to an amplitude
PROBES = 16
SIDE_FRACTION = 0.1  # one of these, at which iterations start on either side
SCREENING_ITERATIONS = 8  # at most
# Predicted gain of log evidence below which a run stops; with 0.05 some runs stopped on
# a plateau
SCREENING_MIN_GAIN = 0.005
SCREENING_ACCURACY = 2.0  # log evidence by which a fit is better at most
COARSE_LEVEL = 2  # halvings of the mesh


@dataclass(frozen=True)
class Comparison:
    """Comparison of some causes, or none, with the trials.

    Parameters
    ----------
    causes : names of the effects; empty for the original model
    log_evidence : gain over the original model
    rms_m : root mean square residual of the centre-line [m]; NaN for causes of earlier
        trials that were not fitted to these
    estimate : estimate with the causes, if they were fitted
    screened : exponents by name after the screening, if they were not fitted
    """

    causes: tuple[str, ...]
    log_evidence: float
    rms_m: float
    estimate: Estimate | None = None
    screened: Mapping[str, float] = field(default_factory=dict)

    @property
    def has_residual(self) -> bool:
        """Whether the residual in these trials is known; else it is NaN."""
        return not np.isnan(self.rms_m)

    @property
    def exponents(self) -> Mapping[str, float]:
        """Exponents of all parameters by name."""
        if self.estimate is None:
            return self.screened
        fitted = self.estimate.parameters
        return dict(zip(fitted["name"], fitted["chi"], strict=True))


@dataclass(frozen=True)
class Comparer:
    """Compare effects added to a model, on the same trials.

    Parameters
    ----------
    model : Model
        Model with the causes found so far.
    observations : sequence of Observation
        The trials.
    base : Comparison
        Comparison of this model with the trials. It may have exponents of more causes.
    original_rms_m : float
        Root mean square residual of the original model [m].
    blocks : int
        Number of independent blocks of time in the trials.
    fit_model : callable
        Fits a model to observations from new starts and from an earlier estimate.
    seed : int
        Seed of the parameter values at which effects are tried.
    """

    model: Model
    observations: Sequence[Observation]
    base: Comparison
    original_rms_m: float
    blocks: int
    fit_model: Callable[[Model, Sequence[Observation], Estimate | None], Estimate]
    seed: int

    def with_base(self, base: Comparison) -> Comparer:
        """Return a comparer of effects added to these causes."""
        extended = self.model.with_effects(*find_effects(base.causes))
        return replace(self, model=extended, base=base)

    def screen(self, effects: Sequence[type[Effect]]) -> Comparison:
        """Compare effects by a few iterations that start at the base.

        They start on a coarse mesh at the best probe of the last effect, and at the
        best ones on either side of its absence: wind to the left and to the right may
        each have a minimum, with other drags. The mesh error at the base is subtracted.

        The error at the new optimum differs: with two trials, the log evidence of the
        right cause was too low by 150. The iterations are therefore continued on the
        given mesh, corrected at the new optimum. If that ends behind the base, which is
        a special case, they begin again at the base.
        """
        hypothesis, coarse, start = self._with_effects_on_coarse_mesh(effects)
        probes = self._probes(hypothesis, effects[-1], start)
        squares = np.mean(coarse.residuals(probes) ** 2, axis=1)
        starts = probes[self._screened_probes(squares)]
        # the solver assumes independent coordinates, the evidence independent blocks
        coordinates = sum(2 * len(trial.s) for trial in coarse.data.trials)
        min_gain = SCREENING_MIN_GAIN * coordinates / (2 * self.blocks)
        runs = fit_least_squares(coarse, starts, SCREENING_ITERATIONS, min_gain)
        chi = runs.chi[np.argmin(runs.loss)]
        compared = self._compare_near(hypothesis, effects, chi, min_gain)
        expected = self.base.log_evidence - self._penalty(effects)
        if compared.log_evidence < expected - SCREENING_ACCURACY:
            from_base = self._compare_near(hypothesis, effects, start, min_gain)
            compared = max(compared, from_base, key=lambda each: each.log_evidence)
        return compared

    def _compare_near(
        self,
        hypothesis: Hypothesis,
        effects: Sequence[type[Effect]],
        chi: np.ndarray,
        min_gain: float,
    ) -> Comparison:
        """Compare effects by a few iterations from exponents (P,) on the given mesh."""
        given = self._likelihood_on_mesh(hypothesis, 1)
        corrected = with_estimated_noise(with_corrected_points(given, chi), chi)
        runs = fit_least_squares(corrected, chi[None], SCREENING_ITERATIONS, min_gain)
        refined = runs.chi[0]
        compared = self.comparison(effects, self._limit_rms_m(hypothesis, refined))
        exponents = dict(zip(hypothesis.model.names, refined.tolist(), strict=True))
        return replace(compared, screened=exponents)

    def _penalty(self, effects: Sequence[type[Effect]]) -> float:
        """Compute what the parameters of effects cost in log evidence (BIC)."""
        parameters = sum(len(effect.parameters) for effect in effects)
        return float(0.5 * parameters * np.log(self.blocks))

    def comparison(
        self,
        effects: Sequence[type[Effect]],
        residual_m: float,
        estimate: Estimate | None = None,
    ) -> Comparison:
        """Compute the log evidence of effects from their residual [m]."""
        causes = [*self.base.causes, *(effect.name for effect in effects)]
        gain = 2 * self.blocks * np.log(self.original_rms_m / residual_m)
        evidence = float(gain - self._penalty(find_effects(causes)))
        return Comparison(tuple(sorted(causes)), evidence, residual_m, estimate)

    def with_gain(self, compared: Comparison, gain: float) -> Comparison:
        """Return a comparison with a higher log evidence and a smaller residual."""
        residual_m = compared.rms_m * float(np.exp(-0.5 * gain / self.blocks))
        evidence = compared.log_evidence + gain
        return replace(compared, log_evidence=evidence, rms_m=residual_m)

    def linear_square(self, effect: type[Effect]) -> float:
        """Compute the mean square residual with an effect in linear approximation.

        The effect is simulated at several probes. Each change of the points, times a
        fitted factor, is combined with a linear fit of the other parameters; the least
        mean square is returned. It costs a tenth of `screen`.
        """
        hypothesis, coarse, start = self._with_effects_on_coarse_mesh((effect,))
        probes = self._probes(hypothesis, effect, start)
        unexplained, *probed = coarse.residuals(np.vstack([start, probes]))
        base_start = start[hypothesis.base_indices]
        least = float(np.mean(unexplained**2))
        for with_effect, fraction in zip(probed, _probe_fractions(), strict=True):
            slopes = np.vstack([self._coarse_slopes, with_effect - unexplained])
            # the factor takes the effect from absent to the end of its range
            low = np.append(-base_start, 0.0)
            high = np.append(1.0 - base_start, 1.0 / fraction)
            normal = slopes @ slopes.T / len(unexplained)
            gradient = slopes @ unexplained / len(unexplained)
            step = minimise_in_box(with_flat_curvature(normal), gradient, low, high)
            residual = unexplained + step @ slopes
            least = min(least, float(np.mean(residual**2)))
        return least

    def _limit_rms_m(self, hypothesis: Hypothesis, chi: np.ndarray) -> float:
        """Compute the root mean square residual at exponents (P,) [m].

        The string has a far finer mesh, or the given one if this leaves less, as in
        `mesh_limit.refine_at_mesh_limit`.
        """
        residuals_m = []
        for factor in (1, REFERENCE_REFINEMENT):
            string = self._likelihood_on_mesh(hypothesis, factor)
            residuals = string.residuals_by_trial(chi[None])
            distances = []
            for trial, residual in zip(string.data.trials, residuals, strict=True):
                errors = residual.reshape(-1, 2) * trial.sigma[:, None]
                distances.append(np.hypot(*errors.T))
            residuals_m.append(rms(np.concatenate(distances)))
        return min(residuals_m)

    @cached_property
    def _on_coarse_mesh(self) -> Likelihood:
        """The likelihood on a coarse mesh, corrected for its error at the base."""
        hypothesis = Hypothesis(self.model)
        coarse = self._likelihood_on_mesh(hypothesis, self._coarse_factor)
        start = self._start(hypothesis)
        return with_estimated_noise(with_corrected_points(coarse, start), start)

    @cached_property
    def _coarse_slopes(self) -> np.ndarray:
        """Jacobian of the residuals at the base, (P, N)."""
        start = self._start(Hypothesis(self.model))
        return linearise(self._on_coarse_mesh, start).slope

    def _with_effects_on_coarse_mesh(
        self, effects: Sequence[type[Effect]]
    ) -> tuple[Hypothesis, Likelihood, np.ndarray]:
        """Add effects to the model on a coarse mesh.

        Returns the hypothesis, its likelihood corrected for the mesh error, and the
        exponents (P,) of the base, with the effects absent.
        """
        hypothesis = Hypothesis(self.model, tuple(effects))
        coarse = self._likelihood_on_mesh(hypothesis, self._coarse_factor)
        start = self._start(hypothesis)
        string, known = hypothesis.model.string, self.model.string
        has_same_mesh = string.points == known.points
        if has_same_mesh and string.largest_step == known.largest_step:
            # absent effects change neither the error nor the noise
            trials = with_model(self._on_coarse_mesh.data.trials, coarse.model)
            return hypothesis, coarse.with_trials(trials), start
        corrected = with_corrected_points(coarse, start)
        return hypothesis, with_estimated_noise(corrected, start), start

    @cached_property
    def _trials(self) -> tuple[PreparedTrial, ...]:
        """The trials with their motions and initial states."""
        return tuple(prepare_trial(self.model, o) for o in self.observations)

    @cached_property
    def _coarse_factor(self) -> float:
        """Segments of the coarse mesh over segments of the given mesh."""
        given = self._likelihood_on_mesh(Hypothesis(self.model), 1)
        level = min(COARSE_LEVEL, len(mesh_ladder(given)) - 1)
        return float(0.5**level)

    def _likelihood_on_mesh(self, hypothesis: Hypothesis, factor: float) -> Likelihood:
        """Return the likelihood of a hypothesis with `factor` times the segments."""
        trials = with_model(self._trials, hypothesis.model)
        given = Likelihood(TrialData(trials), hypothesis.model)
        return given if factor == 1 else likelihood_on_mesh(given, factor)

    def _start(self, hypothesis: Hypothesis) -> np.ndarray:
        """Return the exponents (P,) of the base, with the effects absent."""
        return hypothesis.exponents_from(self.base.exponents)

    def _screened_probes(self, squares: np.ndarray) -> list[int]:
        """Choose the best probe and the best on either side, by mean square (PROBES,).

        Those on either side are away from the base, where all probes end alike.
        """
        numbers = np.arange(PROBES)
        is_away = _probe_fractions() == SIDE_FRACTION
        chosen = [int(np.argmin(squares))]
        for side in (0, 1):
            candidates = numbers[is_away & (numbers % 2 == side)]
            chosen.append(int(candidates[np.argmin(squares[candidates])]))
        return chosen

    def _probes(
        self, hypothesis: Hypothesis, effect: type[Effect], start: np.ndarray
    ) -> np.ndarray:
        """Draw exponents (PROBES, P) with an effect active, near the estimate."""
        rng = np.random.default_rng([self.seed, PROBES])
        indices = hypothesis.parameter_indices(effect, effect.parameters)
        amplitudes = hypothesis.amplitude_indices(effect)
        probes = np.tile(start, (PROBES, 1))
        probes[:, indices] = rng.uniform(0, 1, (PROBES, len(indices)))
        # half of the probes towards either end of the first amplitude's range
        probes[::2, amplitudes[0]] = 0.0
        probes[1::2, amplitudes[0]] = 1.0
        fractions = _probe_fractions()[:, None]
        distance = probes[:, amplitudes] - start[amplitudes]
        probes[:, amplitudes] = start[amplitudes] + fractions * distance
        return probes

    def fit(
        self, effects: Sequence[type[Effect]], start: Estimate | None
    ) -> Comparison:
        """Fit the model with effects, from new starts and from `start`."""
        extended = self.model.with_effects(*effects)
        fitted = self.fit_model(extended, self.observations, start)
        return self.comparison(effects, rms_m(fitted), fitted)


def _probe_fractions() -> np.ndarray:
    """Return the fraction of each probe, (PROBES,)."""
    return np.repeat(PROBE_FRACTIONS, PROBES // len(PROBE_FRACTIONS))


def without_causes(estimate: Estimate) -> Comparison:
    """Return the comparison of the original model."""
    return Comparison(NO_CAUSE, 0.0, rms_m(estimate), estimate)


def rms_m(estimate: Estimate) -> float:
    """Return the root mean square residual of the centre-line [m]."""
    return float(estimate.fit["rms_after"].iloc[0])


def tip_rms_m(estimate: Estimate | None) -> float:
    """Return the root mean square residual of the tip [m]; NaN without a fit."""
    return np.nan if estimate is None else float(estimate.fit["tip_after"].iloc[0])


def noise_m(observations: Sequence[Observation]) -> float:
    """Return the distance by which noise alone moves a measured point [m]."""
    sigma = pd.concat([observation.points["sigma"] for observation in observations])
    return float(np.sqrt(2) * sigma.median())


def explains_half(each: Comparison, base: Comparison, noise_m: float = 0.0) -> bool:
    """Return whether causes explain half of the mean square misfit.

    noise_m: root mean square noise, which is not counted as misfit [m].
    """
    misfit = base.rms_m**2 - noise_m**2
    remaining = each.rms_m**2 - noise_m**2
    return remaining <= (1 - MIN_EXPLAINED_FRACTION) * misfit
