"""Compare causes with trials: on a coarse mesh, and by fits from new starts.

A strong cause, such as a heavy tip, shifts the other parameters, so that a fit from the
old optimum may end in a local minimum. The evidence is that of the Bayesian information
criterion (Schwarz 1978) for independent blocks of time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd

from stringcast.data.artifacts import Observation
from stringcast.data.estimates import Estimate
from stringcast.stages.inference.covariance import linearise
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.likelihood import Likelihood
from stringcast.stages.inference.mesh import mesh_ladder, with_corrected_points
from stringcast.stages.inference.prepared_trial import prepare_trial
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
SCREENED_PROBES = 3  # best probes, which are refined
SCREENING_ITERATIONS = 8  # at most
# Predicted gain of log evidence below which a run stops; with 0.05 some runs stopped on
# a plateau
SCREENING_MIN_GAIN = 0.005
COARSE_LEVEL = 2  # halvings of the mesh


@dataclass(frozen=True)
class Comparison:
    """Comparison of some causes, or none, with the trials.

    Parameters
    ----------
    causes : names of the effects; empty for the original model
    log_evidence : gain over the original model
    estimate : estimate with the causes, if they were fitted
    """

    causes: tuple[str, ...]
    log_evidence: float
    estimate: Estimate | None = None


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
        Comparison of this model with the trials, fitted.
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
    blocks: int
    fit_model: Callable[[Model, Sequence[Observation], Estimate | None], Estimate]
    seed: int

    def with_base(self, base: Comparison) -> Comparer:
        """Return a comparer of effects added to these causes."""
        extended = self.model.with_effects(*find_effects(base.causes))
        return replace(self, model=extended, base=base)

    def comparison(
        self,
        effects: Sequence[type[Effect]],
        square_ratio: float,
        estimate: Estimate | None = None,
    ) -> Comparison:
        """Compute the log evidence of effects from the ratio of mean squares."""
        gain = self.blocks * -np.log(max(square_ratio, np.finfo(float).tiny))
        added = sum(len(effect.parameters) for effect in effects)
        evidence = gain - 0.5 * added * np.log(self.blocks)
        causes = [*self.base.causes, *(effect.name for effect in effects)]
        return Comparison(
            tuple(sorted(causes)), self.base.log_evidence + float(evidence), estimate
        )

    def linear_square(self, effect: type[Effect]) -> float:
        """Compute the mean square residual with an effect in linear approximation.

        The effect is simulated at several probes. Each change of the points, times a
        fitted factor, is combined with a linear fit of the other parameters; the least
        mean square is returned. It costs a tenth of `screened_square`.
        """
        hypothesis, coarse, start = self._with_effects_on_coarse_mesh((effect,))
        probes = self._probes(hypothesis, effect, start)
        unexplained, *probed = coarse.residuals(np.vstack([start, probes]))
        base_start = start[hypothesis.base_indices]
        fractions = np.repeat(PROBE_FRACTIONS, PROBES // len(PROBE_FRACTIONS))
        least = float(np.mean(unexplained**2))
        for with_effect, fraction in zip(probed, fractions, strict=True):
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

    def screened_square(self, effects: Sequence[type[Effect]]) -> float:
        """Compute the mean square residual after a few iterations on a coarse mesh.

        They start at the best probes of the last effect. The mesh error at the estimate
        is subtracted. Otherwise effects that resemble it, such as a tilt of gravity,
        would rank too high.
        """
        hypothesis, coarse, start = self._with_effects_on_coarse_mesh(effects)
        starts = start[None]
        if effects:
            probes = self._probes(hypothesis, effects[-1], start)
            squares = np.mean(coarse.residuals(probes) ** 2, axis=1)
            starts = probes[np.argsort(squares, kind="stable")[:SCREENED_PROBES]]
        # the solver assumes independent coordinates, the evidence independent blocks
        coordinates = sum(2 * len(trial.s) for trial in coarse.data.trials)
        min_gain = SCREENING_MIN_GAIN * coordinates / (2 * self.blocks)
        runs = fit_least_squares(coarse, starts, SCREENING_ITERATIONS, min_gain)
        return float(np.mean(runs.residual[np.argmin(runs.loss)] ** 2))

    @cached_property
    def _on_coarse_mesh(self) -> Likelihood:
        """The likelihood on a coarse mesh, corrected for its error at the estimate."""
        coarse, start = self._coarse_likelihood(Hypothesis(self.model))
        return with_estimated_noise(with_corrected_points(coarse, start), start)

    @cached_property
    def _coarse_slopes(self) -> np.ndarray:
        """Jacobian of the residuals at the estimate, (P, N)."""
        _, start = self._coarse_likelihood(Hypothesis(self.model))
        return linearise(self._on_coarse_mesh, start).slope

    def _with_effects_on_coarse_mesh(
        self, effects: Sequence[type[Effect]]
    ) -> tuple[Hypothesis, Likelihood, np.ndarray]:
        """Add effects to the model on a coarse mesh.

        Returns the hypothesis, its likelihood corrected for the mesh error, and the
        exponents (P,) of the estimate, with the effects absent.
        """
        hypothesis = Hypothesis(self.model, tuple(effects))
        coarse, start = self._coarse_likelihood(hypothesis)
        if hypothesis.model.string == self.model.string:
            trials = []
            known = self._on_coarse_mesh.data.trials
            for trial, corrected in zip(coarse.data.trials, known, strict=True):
                trials.append(replace(trial, points=corrected.points))
            coarse = coarse.with_trials(tuple(trials))
        else:
            # a string with shorter steps has another error
            coarse = with_corrected_points(coarse, start)
        return hypothesis, with_estimated_noise(coarse, start), start

    def _coarse_likelihood(
        self, hypothesis: Hypothesis
    ) -> tuple[Likelihood, np.ndarray]:
        """Return the likelihood on a coarse mesh, and the exponents of the estimate."""
        assert self.base.estimate is not None
        trials = [prepare_trial(hypothesis.model, o) for o in self.observations]
        likelihood = Likelihood(TrialData(tuple(trials)), hypothesis.model)
        ladder = mesh_ladder(likelihood)
        coarse = ladder[min(COARSE_LEVEL, len(ladder) - 1)]
        fitted = self.base.estimate.parameters
        exponents = dict(zip(fitted["name"], fitted["chi"], strict=True))
        return coarse, hypothesis.exponents_from(exponents)

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
        fractions = np.repeat(PROBE_FRACTIONS, PROBES // len(PROBE_FRACTIONS))[:, None]
        distance = probes[:, amplitudes] - start[amplitudes]
        probes[:, amplitudes] = start[amplitudes] + fractions * distance
        return probes

    def fit(
        self, effects: Sequence[type[Effect]], start: Estimate | None
    ) -> Comparison:
        """Fit the model with effects, from new starts and from `start`."""
        base = self.base.estimate
        assert base is not None
        extended = self.model.with_effects(*effects)
        fitted = self.fit_model(extended, self.observations, start)
        square_ratio = (rms_m(fitted) / rms_m(base)) ** 2
        return self.comparison(effects, square_ratio, fitted)


def rms_m(estimate: Estimate) -> float:
    """Return the root mean square residual of the centre-line [m]."""
    return float(estimate.fit["rms_after"].iloc[0])


def tip_rms_m(estimate: Estimate | None) -> float:
    """Return the root mean square residual of the tip [m]; NaN without a fit."""
    return np.nan if estimate is None else float(estimate.fit["tip_after"].iloc[0])


def most_evident_fit(compared: Iterable[Comparison]) -> Comparison:
    """Return the most evident of the fitted comparisons."""
    fitted = [each for each in compared if each.estimate is not None]
    return max(fitted, key=lambda each: each.log_evidence)


def noise_m(observations: Sequence[Observation]) -> float:
    """Return the distance by which noise alone moves a measured point [m]."""
    sigma = pd.concat([observation.points["sigma"] for observation in observations])
    return float(np.sqrt(2) * sigma.median())


def explains_half(each: Comparison, base: Comparison, noise_m: float = 0.0) -> bool:
    """Return whether fitted causes explain half of the mean square misfit.

    noise_m: root mean square noise, which is not counted as misfit [m].
    """
    if each.estimate is None or base.estimate is None:
        return False
    misfit = rms_m(base.estimate) ** 2 - noise_m**2
    remaining = rms_m(each.estimate) ** 2 - noise_m**2
    return remaining <= (1 - MIN_EXPLAINED_FRACTION) * misfit
