"""Trials about a fit, to first order: what else would move them, and what the fitted
parameters would do about that.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stringcast.stages.inference.discrepancy import marginal_log_likelihood
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import Fit
from stringcast.stages.inference.likelihood import PRIOR_PRECISION
from stringcast.stages.inference.solver import DIVERGED_RESIDUAL
from stringcast.stages.inference.trial_data import TrialData


class LinearisedFit:
    """Data about a fit, to first order."""

    def __init__(self, data: TrialData, parent: Fit) -> None:
        self.data, self.parent = data.for_hypothesis(parent.hypothesis), parent
        self.white_slopes = self.data.whiten(parent.slopes, parent.scale_indices)
        self.white_residual = self.data.whiten(
            [r[None] for r in parent.residuals], parent.scale_indices
        )[0]
        self.covariance = np.linalg.inv(
            self.white_slopes @ self.white_slopes.T
            + PRIOR_PRECISION * np.eye(len(parent.chi))
        )

    def responses(self, hypothesis: Hypothesis, chi: np.ndarray) -> list[np.ndarray]:
        """What exponents (C, P) change in each trial, (C, 2 n); LOST where they cannot
        be simulated.
        """
        raw = self.data.residuals(hypothesis.model, chi)
        lost = np.any([(each == DIVERGED_RESIDUAL).any(axis=1) for each in raw], axis=0)
        pairs = zip(raw, self.parent.residuals, strict=True)
        return [
            np.where(lost[:, None], DIVERGED_RESIDUAL, each - own)
            for each, own in pairs
        ]

    def parameter_steps(
        self, responses: Sequence[np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray]:
        """What the fitted parameters do about responses, (C, P), and what is left of
        these, white, (C, N).
        """
        white = self.data.whiten(responses, self.parent.scale_indices)
        step = -(white @ self.white_slopes.T) @ self.covariance
        return step, white + step @ self.white_slopes

    def refit_at_values(
        self, place: int, values: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Exponents (C, P) with one at other values (C,), and the others as they suit
        that, to first order; with the gain of the log-likelihood, (C,).
        """
        parent = self.parent
        chi = np.repeat(parent.chi[None], len(values), axis=0)
        chi[:, place] = values
        responses = self.responses(parent.hypothesis, chi)
        step, held = self.parameter_steps(responses)[0], self.covariance[place]
        # the least with that one held
        step = step - step[:, [place]] * held / held[place]
        return np.clip(chi + step, 0.0, 1.0), self.log_likelihood_gains(
            responses, step, np.ones(len(chi))
        )

    def early_gains(
        self, responses: Sequence[np.ndarray], ends: np.ndarray
    ) -> np.ndarray:
        """Of half the sum of squares by responses until a time in each trial [s], (K,);
        (C,).
        """
        gain = np.zeros(len(responses[0]))
        for trial, own, each, end in zip(
            self.data.trials, self.parent.residuals, responses, ends, strict=True
        ):
            seen = np.repeat(trial.times[trial.frame] <= end, 2)
            gain += 0.5 * (
                np.sum(own[seen] ** 2) - np.sum((own + each)[:, seen] ** 2, axis=1)
            )
        return gain

    def log_likelihood_gains(
        self, responses: Sequence[np.ndarray], step: np.ndarray, times: np.ndarray
    ) -> np.ndarray:
        """Of the log-likelihood by so many times (C,) a response and what is done about
        it, (C,).
        """
        told = zip(self.parent.residuals, responses, self.parent.slopes, strict=True)
        moved = [
            own + times[:, None] * (each + step @ slope) for own, each, slope in told
        ]
        gain = (
            marginal_log_likelihood(self.data.log_likelihood_by_scale(moved))
            - self.parent.log_likelihood_by_trial[:, None]
        ).sum(axis=0)
        return np.where((responses[0] == DIVERGED_RESIDUAL).any(axis=1), -np.inf, gain)
