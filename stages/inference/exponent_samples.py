"""Samples of exponents under a likelihood that is normal in the parameters' values.

Exponents have uniform priors in [0, 1]. Metropolis chains alternate between two
proposals. Steps in values follow narrow valleys, which are straight in values; their
covariance depends on where they start (Girolami and Calderhead, J. R. Stat. Soc. B 73,
123, 2011). Steps in the exponent of one parameter cover its whole range.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stringcast.stages.model.parameter import (
    Parameter,
    parameter_exponents,
    parameter_slopes,
    parameter_values,
)

CHAINS = 40
WARM_UP_STEPS = 300  # from the centre, until samples are taken
STEPS_APART = 50  # between two samples of a chain
STEP_WIDTH = 1 / 7  # standard deviation of an undetermined exponent in a step in values
ROUNDING = 1e-12  # of a precision: keeps matrices positive where data are exact
LEAST_SLOPE = 1e-150


@dataclass(frozen=True)
class NormalInValues:
    """A density of exponents in [0, 1] that is normal in the values.

    Parameters
    ----------
    parameters
        The parameters, P of them.
    centre
        Exponents of the most likely values, (P,).
    precision
        Inverse of the covariance of the values over their units, (P, P).
    unit
        Units of the values, (P,).
    """

    parameters: Sequence[Parameter]
    centre: np.ndarray
    precision: np.ndarray
    unit: np.ndarray

    def sample(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Sample exponents, (count, P)."""
        chi = np.tile(self.centre, (CHAINS, 1))
        log_likelihood = self._log_likelihood(chi)
        samples: list[np.ndarray] = []
        step = 0
        while len(samples) * CHAINS < count:
            step += 1
            propose = self._step_in_values if step % 2 else self._step_in_exponent
            proposed, log_ratio = propose(chi, rng)
            proposed_log_likelihood = self._log_likelihood(proposed)
            log_ratio += proposed_log_likelihood - log_likelihood
            is_accepted = np.log(rng.random(CHAINS)) < log_ratio
            chi = np.where(is_accepted[:, None], proposed, chi)
            log_likelihood = np.where(
                is_accepted, proposed_log_likelihood, log_likelihood
            )
            if step > WARM_UP_STEPS and step % STEPS_APART == 0:
                samples.append(chi)
        return np.concatenate(samples)[:count]

    def _log_likelihood(self, chi: np.ndarray) -> np.ndarray:
        """Compute the log likelihood of exponents (K, P), (K,)."""
        centre = parameter_values(self.parameters, self.centre)
        moved = (parameter_values(self.parameters, chi) - centre) / self.unit
        return np.asarray(-0.5 * np.sum((moved @ self.precision) * moved, axis=1))

    def _step_in_exponent(
        self, chi: np.ndarray, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """Propose a uniform exponent of one random parameter in each chain.

        Returns the proposed exponents (K, P), and the log ratio of the densities of the
        reverse step and of the step, (K,).
        """
        chains = np.arange(len(chi))
        changed = rng.integers(len(self.centre), size=len(chi))
        proposed = chi.copy()
        proposed[chains, changed] = rng.random(len(chi))
        return proposed, np.zeros(len(chi))

    def _step_in_values(
        self, chi: np.ndarray, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """Propose a step in the values of all parameters.

        Returns the same as `_step_in_exponent`.
        """
        root, log_prior = self._step_root(chi)
        normal = rng.standard_normal(chi.shape)
        upper = root.transpose(0, 2, 1)
        step = np.linalg.solve(upper, normal[..., None])[..., 0]
        values = parameter_values(self.parameters, chi) + self.unit * step
        low = np.array([parameter.low for parameter in self.parameters])
        high = np.array([parameter.high for parameter in self.parameters])
        is_inside = ((values >= low) & (values <= high)).all(axis=1)
        moved = parameter_exponents(self.parameters, np.clip(values, low, high))
        proposed = np.where(is_inside[:, None], moved, chi)

        new_root, new_log_prior = self._step_root(proposed)
        normal_back = np.sum(new_root * step[:, :, None], axis=1)
        reverse = new_log_prior + _log_normal(new_root, normal_back)
        forward = log_prior + _log_normal(root, normal)
        return proposed, np.where(is_inside, reverse - forward, -np.inf)

    def _step_root(self, chi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute lower roots of the precision of steps in values, (K, P, P).

        Returns also the log prior of the values, (K,).
        """
        slope = np.abs(parameter_slopes(self.parameters, chi) / self.unit)
        slope = np.maximum(slope, LEAST_SLOPE)
        size = len(self.centre)
        diagonal = 1 / (STEP_WIDTH * slope) ** 2 + ROUNDING * np.diag(self.precision)
        precision = self.precision + diagonal[:, None] * np.eye(size)
        root = np.linalg.cholesky(size * precision)
        return root, -np.log(slope).sum(axis=1)


def _log_normal(root: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Compute log densities of normal steps, (K,), up to a constant.

    root: lower roots of their precision, (K, P, P). normal: the steps times the roots,
    (K, P).
    """
    log_diagonal = np.log(np.diagonal(root, axis1=1, axis2=2))
    return np.asarray(log_diagonal.sum(axis=1) - 0.5 * np.sum(normal**2, axis=1))
