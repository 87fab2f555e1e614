"""Compare effects with the trials in addition to a base: by a screening or by a fit.

A strong cause, such as a heavy tip, shifts the other parameters, so that a fit from the
old optimum may end in a local minimum. A fit therefore has new starts. A screening is
cheaper: it probes an effect on a coarse mesh, iterates there, and iterates again on the
given mesh.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from stringcast.data.artifacts import Observation
from stringcast.data.estimates import Estimate
from stringcast.stages.common import mean_square_over_trials
from stringcast.stages.explain.comparison import Comparison, bic_penalty
from stringcast.stages.inference.covariance import linearise
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.likelihood import Likelihood, time_blocks
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

# Size of each probe: fraction of the way from absent to an amplitude, (PROBES,)
PROBE_FRACTIONS = np.repeat([0.01, 0.03, 0.1, 0.3], 4)
PROBES = len(PROBE_FRACTIONS)
SIDE_FRACTION = 0.1  # one of these, at which iterations start on each side
SCREENING_ITERATIONS = 8  # at most
# Predicted gain of log evidence below which a run stops; with 0.05 some runs stopped on
# a plateau
SCREENING_MIN_GAIN = 0.005
SCREENING_ACCURACY = 2.0  # log evidence by which a fit is better at most
MAX_CONTINUATIONS = 4  # of a screening whose log evidence has not settled
COARSE_LEVEL = 2  # halvings of the mesh


@dataclass(frozen=True)
class Comparer:
    """Compare effects in addition to a base, on the same trials.

    Parameters
    ----------
    model : Model
        Model with the causes of the base.
    observations : sequence of Observation
        The trials.
    base : Comparison
        Comparison of this model with the trials. It may have exponents of more causes.
    original_ratio : float
        Root mean square residual of the original model over the points' sigma.
    blocks : int
        Number of independent blocks of time in the trials.
    fit_model : callable
        Fits a model to observations from new starts and from an earlier estimate.
    seed : int
        Seed of the probes.
    """

    model: Model
    observations: Sequence[Observation]
    base: Comparison
    original_ratio: float
    blocks: int
    fit_model: Callable[[Model, Sequence[Observation], Estimate | None], Estimate]
    seed: int

    def with_base(self, base: Comparison) -> Comparer:
        """Return a comparer of effects added to these causes."""
        extended = self.model.with_effects(*find_effects(base.causes))
        return replace(self, model=extended, base=base)

    def fit(
        self, effects: Sequence[type[Effect]], start: Estimate | None
    ) -> Comparison:
        """Fit the base with effects, from new starts and from an estimate."""
        extended = self.model.with_effects(*effects)
        fitted = self.fit_model(extended, self.observations, start)
        return self.compare(effects, fitted.residual_ratio, fitted)

    def compare(
        self,
        effects: Sequence[type[Effect]],
        residual_ratio: float,
        estimate: Estimate | None = None,
    ) -> Comparison:
        """Compute the log evidence of the base with effects from its residual."""
        causes = [*self.base.causes, *(effect.name for effect in effects)]
        gain = 2 * self.blocks * np.log(self.original_ratio / residual_ratio)
        evidence = float(gain - bic_penalty(find_effects(causes), self.blocks))
        return Comparison(tuple(sorted(causes)), evidence, residual_ratio, estimate)

    def linear_mean_square(self, effect: type[Effect]) -> float:
        """Compute the mean square residual with an effect in linear approximation.

        The change of the residuals by each probe is one more column of the linear
        model. The least mean square over the probes is returned, with the weights of
        blocks. It costs a tenth of `screen`.
        """
        hypothesis, coarse, absent = self._on_coarse_mesh_with(effect)
        probes = self._draw_probes(hypothesis, effect, absent)
        # Residuals of the base (N,) and of each probe (PROBES, N)
        residuals = coarse.residuals(np.vstack([absent, probes]))
        unexplained, *probed = np.sqrt(self._block_weights) * residuals
        base_slopes = np.sqrt(self._block_weights) * self._coarse_slopes
        base_chi = absent[hypothesis.base_indices]
        least = float(np.mean(unexplained**2))
        for with_effect, fraction in zip(probed, PROBE_FRACTIONS, strict=True):
            slopes = np.vstack([base_slopes, with_effect - unexplained])
            normal = slopes @ slopes.T / len(unexplained)
            gradient = slopes @ unexplained / len(unexplained)
            # Multiples of the probe reach from absent to the end of its range
            low = np.append(-base_chi, 0.0)
            high = np.append(1.0 - base_chi, 1.0 / fraction)
            step = minimise_in_box(with_flat_curvature(normal), gradient, low, high)
            residual = unexplained + step @ slopes
            least = min(least, float(np.mean(residual**2)))
        return least

    def screen(self, effect: type[Effect]) -> Comparison:
        """Compare an effect by a few iterations of least squares.

        They start on a coarse mesh at the best probe, and at the best one on each side
        of the effect's absence: wind to the left and to the right may each have a
        minimum, with other drags. They continue on the given mesh.
        """
        hypothesis, coarse, absent = self._on_coarse_mesh_with(effect)
        probes = self._draw_probes(hypothesis, effect, absent)
        squares = np.mean(coarse.residuals(probes) ** 2, axis=1)  # (PROBES,)
        amplitude = hypothesis.amplitude_indices(effect)[0]
        sides = len(_active_ends(absent[amplitude]))
        starts = probes[_best_probes(squares, sides)]
        runs = fit_least_squares(coarse, starts, SCREENING_ITERATIONS, self._min_gain)
        best = runs.chi[np.argmin(runs.loss)]
        screened = self._refine(hypothesis, best)

        # With the effect absent the model is the base, so it need not end behind it
        expected = self.base.log_evidence - bic_penalty([effect], self.blocks)
        if screened.log_evidence < expected - SCREENING_ACCURACY:
            from_base = self._refine(hypothesis, absent)
            screened = max(screened, from_base, key=lambda each: each.log_evidence)
        return screened

    def settle(
        self, effects: Sequence[type[Effect]], screened: Comparison
    ) -> Comparison:
        """Continue the iterations of a screening until its log evidence settles.

        Each time, the mesh error is subtracted where the last iterations ended. A wind
        that moved the tip by 6 mm gained 60 of log evidence by this.
        """
        hypothesis = Hypothesis(self.model, tuple(effects))
        for _ in range(MAX_CONTINUATIONS):
            chi = hypothesis.exponents_from(screened.exponents)
            continued = self._refine(hypothesis, chi)
            gain = continued.log_evidence - screened.log_evidence
            if gain > 0:
                screened = continued
            if gain < SCREENING_ACCURACY:
                break
        return screened

    def screen_base(self) -> Comparison:
        """Compare the base without further effects by a few iterations."""
        return self._refine(Hypothesis(self.model), self._base_chi)

    def _refine(self, hypothesis: Hypothesis, chi: np.ndarray) -> Comparison:
        """Compare a hypothesis by a few iterations from exponents (P,).

        The mesh error there is subtracted. With that of the base, the log evidence of
        the right cause was too low by 150 in two trials.
        """
        given = self._likelihood_on_mesh(hypothesis, 1)
        corrected = with_estimated_noise(with_corrected_points(given, chi), chi)
        runs = fit_least_squares(
            corrected, chi[None], SCREENING_ITERATIONS, self._min_gain
        )
        refined = runs.chi[0]
        ratio = self._residual_at_mesh_limit(hypothesis, refined)
        compared = self.compare(hypothesis.causes, ratio)
        exponents = dict(zip(hypothesis.model.names, refined.tolist(), strict=True))
        return replace(compared, screened=exponents)

    def _residual_at_mesh_limit(self, hypothesis: Hypothesis, chi: np.ndarray) -> float:
        """Compute the root mean square residual over sigma at exponents (P,).

        The string has a far finer mesh, or the given one if this leaves less, as in
        `mesh_limit.refine_at_mesh_limit`.
        """
        mean_squares = []
        for factor in (1, REFERENCE_REFINEMENT):
            string = self._likelihood_on_mesh(hypothesis, factor)
            residuals = string.residuals_by_trial(chi[None])
            mean_squares.append(mean_square_over_trials(residuals))
        return float(np.sqrt(min(mean_squares)))

    def _draw_probes(
        self, hypothesis: Hypothesis, effect: type[Effect], absent: np.ndarray
    ) -> np.ndarray:
        """Draw exponents (PROBES, P) with an effect active, near the base.

        absent: exponents of the base, (P,).
        """
        rng = np.random.default_rng([self.seed, PROBES])
        indices = hypothesis.parameter_indices(effect, effect.parameters)
        amplitudes = hypothesis.amplitude_indices(effect)
        probes = np.tile(absent, (PROBES, 1))
        probes[:, indices] = rng.uniform(0, 1, (PROBES, len(indices)))
        # Probes alternate between the sides of the first amplitude's absence
        first = amplitudes[0]
        probes[:, first] = np.resize(_active_ends(absent[first]), PROBES)
        distance = probes[:, amplitudes] - absent[amplitudes]
        probes[:, amplitudes] = absent[amplitudes] + PROBE_FRACTIONS[:, None] * distance
        return probes

    def _on_coarse_mesh_with(
        self, effect: type[Effect]
    ) -> tuple[Hypothesis, Likelihood, np.ndarray]:
        """Add an effect to the model on a coarse mesh.

        Returns the hypothesis, its likelihood corrected for the mesh error at the base,
        and the exponents (P,) of the base, with the effect absent.
        """
        hypothesis = Hypothesis(self.model, (effect,))
        coarse = self._likelihood_on_mesh(hypothesis, self._coarse_factor)
        absent = hypothesis.exponents_from(self.base.exponents)
        string = hypothesis.model.string
        base_string = self.model.string
        has_same_mesh = string.points == base_string.points
        if has_same_mesh and string.largest_step == base_string.largest_step:
            # An absent effect changes neither the error nor the noise
            trials = with_model(self._coarse_base.data.trials, coarse.model)
            return hypothesis, coarse.with_trials(trials), absent
        corrected = with_corrected_points(coarse, absent)
        return hypothesis, with_estimated_noise(corrected, absent), absent

    @property
    def _min_gain(self) -> float:
        """Gain of the solver below which iterations stop.

        The solver counts coordinates as independent, the evidence blocks.
        """
        coordinates = sum(2 * len(trial.s) for trial in self._trials)
        return SCREENING_MIN_GAIN * coordinates / (2 * self.blocks)

    @cached_property
    def _base_chi(self) -> np.ndarray:
        """Exponents of the base, (P,)."""
        return Hypothesis(self.model).exponents_from(self.base.exponents)

    @cached_property
    def _coarse_base(self) -> Likelihood:
        """The likelihood on a coarse mesh, corrected for its error at the base."""
        coarse = self._likelihood_on_mesh(Hypothesis(self.model), self._coarse_factor)
        corrected = with_corrected_points(coarse, self._base_chi)
        return with_estimated_noise(corrected, self._base_chi)

    @cached_property
    def _block_weights(self) -> np.ndarray:
        """Weights of residuals in the linear approximation, (N,).

        Where a string whips, small errors have grown, and the residual is no longer
        linear in the parameters. So the misfit of the base reduces the weight of its
        block of time, as in a fit with Cauchy errors.
        """
        residual = self._coarse_base.residuals(self._base_chi[None])[0]
        block = time_blocks(self._coarse_base.data.trials)
        mean_square = np.bincount(block, residual**2) / np.bincount(block)
        return 1 / (1 + mean_square[block])

    @cached_property
    def _coarse_slopes(self) -> np.ndarray:
        """Jacobian of the residuals at the base, (P, N)."""
        return linearise(self._coarse_base, self._base_chi).slope

    @cached_property
    def _coarse_factor(self) -> float:
        """Segments of the coarse mesh over segments of the given mesh."""
        given = self._likelihood_on_mesh(Hypothesis(self.model), 1)
        level = min(COARSE_LEVEL, len(mesh_ladder(given)) - 1)
        return float(0.5**level)

    @cached_property
    def _trials(self) -> tuple[PreparedTrial, ...]:
        """The trials with their motions and initial states."""
        return tuple(prepare_trial(self.model, o) for o in self.observations)

    def _likelihood_on_mesh(self, hypothesis: Hypothesis, factor: float) -> Likelihood:
        """Return the likelihood of a hypothesis with `factor` times the segments."""
        trials = with_model(self._trials, hypothesis.model)
        given = Likelihood(TrialData(trials), hypothesis.model)
        return given if factor == 1 else likelihood_on_mesh(given, factor)


def _active_ends(absent: float) -> list[float]:
    """List the ends of an amplitude's range at which its effect is active.

    There is only one if the amplitude cannot be negative, like a mass.

    absent: exponent of the absent effect.
    """
    return [end for end in (0.0, 1.0) if not np.isclose(end, absent)]


def _best_probes(squares: np.ndarray, sides: int) -> list[int]:
    """Choose the best probe and the best on each side, by mean square (PROBES,).

    Those on a side are away from the base, where all probes end alike.
    """
    best = [int(np.argmin(squares))]
    for side in range(sides):
        is_on_side = np.arange(PROBES) % sides == side
        others = np.flatnonzero(is_on_side & (PROBE_FRACTIONS == SIDE_FRACTION))
        best.append(int(others[np.argmin(squares[others])]))
    return best
