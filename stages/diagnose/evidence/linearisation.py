"""Linearisation of trials at a fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stringcast.stages.inference.discrepancy_grid import marginal_log_likelihood
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import Fit
from stringcast.stages.inference.likelihood import PRIOR_PRECISION
from stringcast.stages.inference.solver import DIVERGED_RESIDUAL
from stringcast.stages.inference.trial_data import ByTrial, TrialData


@dataclass(eq=False)
class LinearisedFit:
    """A fit whose parameters adapt to a further displacement by a Gauss-Newton step.

    Their prior is centred at the fit.
    """

    data: TrialData
    parent: Fit

    def __post_init__(self) -> None:
        """Whiten the residuals and slopes of the fit."""
        self.data = self.data.for_hypothesis(self.parent.hypothesis)
        grid_points = self.parent.grid_points
        residuals = [residual[None] for residual in self.parent.residuals]
        # (P, N) and (N,)
        self.white_slopes = self.data.whiten(self.parent.slopes, grid_points)
        self.white_residual = self.data.whiten(residuals, grid_points)[0]
        prior = PRIOR_PRECISION * np.eye(len(self.parent.chi))
        self.information = self.white_slopes @ self.white_slopes.T + prior  # (P, P)
        self.covariance = np.linalg.inv(self.information)

    def responses(self, hypothesis: Hypothesis, chi: np.ndarray) -> ByTrial:
        """Compute the change of each trial's residuals (C, 2 n) at exponents (C, P).

        A candidate that diverges in any trial is DIVERGED_RESIDUAL in all of them.
        """
        residuals = self.data.residuals(hypothesis.model, chi)
        by_trial = [(rows == DIVERGED_RESIDUAL).any(axis=1) for rows in residuals]
        diverged = np.any(by_trial, axis=0)[:, None]  # (C, 1)
        responses = []
        for residual, before in zip(residuals, self.parent.residuals, strict=True):
            change = residual - before
            responses.append(np.where(diverged, DIVERGED_RESIDUAL, change))
        return responses

    def parameter_steps(self, responses: ByTrial) -> tuple[np.ndarray, np.ndarray]:
        """Compute the steps of the fitted parameters that best cancel responses.

        Returns
        -------
        steps : numpy.ndarray, shape (C, P)
        remainder : numpy.ndarray, shape (C, N)
            White responses after the steps.
        """
        white = self.data.whiten(responses, self.parent.grid_points)
        steps = -(white @ self.white_slopes.T) @ self.covariance
        return steps, white + steps @ self.white_slopes

    def refit_at_values(
        self,
        index: int,
        values: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Set one exponent to other values (C,) and adapt the others.

        Returns
        -------
        chi : numpy.ndarray, shape (C, P)
        gains : numpy.ndarray, shape (C,)
            Gains in log-likelihood, to first order.
        """
        chi = np.repeat(self.parent.chi[None], len(values), axis=0)
        chi[:, index] = values
        responses = self.responses(self.parent.hypothesis, chi)
        steps, _ = self.parameter_steps(responses)
        # Condition on a zero step of the given exponent
        covariance = self.covariance[index]
        steps = steps - steps[:, [index]] * covariance / covariance[index]
        gains = self.log_likelihood_gains(responses, steps, np.ones(len(chi)))
        return np.clip(chi + steps, 0.0, 1.0), gains

    def early_gains(self, responses: ByTrial, end_times: np.ndarray) -> np.ndarray:
        """Reduction of half the sum of squares before a time in each trial [s], (C,).

        Parameters
        ----------
        responses : sequence of numpy.ndarray, shape (C, 2 n)
        end_times : numpy.ndarray, shape (K,)
        """
        gain = np.zeros(len(responses[0]))
        for k, trial in enumerate(self.data.trials):
            is_early = np.repeat(trial.point_times <= end_times[k], 2)
            residual = self.parent.residuals[k]
            before = residual[is_early]
            after = (residual + responses[k])[:, is_early]
            removed = np.sum(before**2) - np.sum(after**2, axis=1)
            gain += 0.5 * removed
        return gain

    def log_likelihood_gains(
        self,
        responses: ByTrial,
        steps: np.ndarray,
        factors: np.ndarray,
    ) -> np.ndarray:
        """Gain in log-likelihood by multiples (C,) of responses and steps, (C,).

        It is minus infinity for candidates that diverge.
        """
        moved = []
        for k, residual in enumerate(self.parent.residuals):
            change = responses[k] + steps @ self.parent.slopes[k]
            moved.append(residual + factors[:, None] * change)
        by_grid_point = self.data.log_likelihood_by_grid_point(moved)
        after = marginal_log_likelihood(by_grid_point)  # (K, C)
        before = self.parent.log_likelihood_by_trial[:, None]
        gain = (after - before).sum(axis=0)
        diverged = (responses[0] == DIVERGED_RESIDUAL).any(axis=1)
        return np.where(diverged, -np.inf, gain)
