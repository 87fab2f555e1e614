"""Fit the alignment: seen positions of the arm against those of the joint angles.

Rotation, origin and scale of the picture, the clock offset and all candidates are
effects of the forward model. Solver, robust loss and covariance are those of
`inference`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from stringcast.stages.align.sightings import SightedTrial
from stringcast.stages.common import mad_sigma
from stringcast.stages.inference import solver
from stringcast.stages.inference.covariance import Covariance, jackknife_covariance
from stringcast.stages.inference.huber import HUBER_LIMIT, huber_loss, huber_weights
from stringcast.stages.model.effect import amplitude_parameters
from stringcast.stages.model.library import find_effects
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import (
    Parameter,
    parameter_exponents,
    parameter_values,
)

REQUIRED_EFFECTS = ("time_offset", "camera_rotation", "pixel_scale", "camera_offset")
CANDIDATE_EFFECTS = ("arm_lag", "clock_drift", "rolling_shutter", "lens_distortion")
TIME_BLOCKS = 20  # of the jackknife
DIFFERENCE_STEP = 1e-4  # of a parameter's range, for the central difference
# predicted gain of log-likelihood at which the solver stops; small, because deviances
# are compared
CONVERGENCE_TOLERANCE = 1e-3
MAX_SCALE_ROUNDS = 3  # fits in which the robust scale converges
MIN_DEVIANCE_GAIN = 9.0  # for an effect to be added; by chance 1 in 400
START_LAG_S = 0.004  # at zero, slopes of lag and clock offset are equal


def measurement_model(model: Model) -> Model:
    """Return a model with the same arm and camera and the effects of an alignment only.

    Effects are ordered by name, as in settings: rotation and shift do not commute.
    """
    effects = find_effects(sorted((*REQUIRED_EFFECTS, *CANDIDATE_EFFECTS)))
    return Model(model.string, model.arm, model.camera).with_effects(*effects)


@dataclass(frozen=True)
class AlignmentProblem:
    """Trials that share one alignment, and a model with all candidate effects."""

    model: Model
    trials: tuple[SightedTrial, ...]

    @cached_property
    def sigma(self) -> np.ndarray:
        """Standard deviations of all sightings (N,) [m]."""
        return np.concatenate([trial.sightings.sigma for trial in self.trials])

    @cached_property
    def times(self) -> np.ndarray:
        """Times of all sightings (N,) [s], by the camera's clock."""
        sightings = [trial.sightings for trial in self.trials]
        return np.concatenate([seen.times[seen.frame] for seen in sightings])

    @cached_property
    def max_hand_speed(self) -> float:
        """The largest speed of the hand in any trial [m/s]."""
        largest = 0.0
        for motion in (trial.motion for trial in self.trials):
            velocity = self.model.arm.grasp_velocity(motion.angles, motion.speeds)
            speed = np.linalg.norm(velocity[..., :2], axis=-1)
            largest = max(largest, float(speed.max()))
        return largest

    @cached_property
    def blocks(self) -> np.ndarray:
        """Time block of each sighting (N,); blocks do not cross trials."""
        durations = [max(float(np.ptp(t.sightings.times)), 1e-9) for t in self.trials]
        block_length = sum(durations) / TIME_BLOCKS
        blocks, first = [], 0
        for trial, duration in zip(self.trials, durations, strict=True):
            seen = trial.sightings
            count = max(round(duration / block_length), 1)
            # the last time stays below 1
            share = (seen.times - seen.times[0]) / (duration * (1 + 1e-9))
            blocks.append(first + (share * count).astype(int)[seen.frame])
            first += count
        return np.concatenate(blocks)

    @staticmethod
    def parameters(effects: Sequence[str]) -> tuple[str, ...]:
        """Return the qualified names of the amplitudes of effects."""
        names: list[str] = []
        for effect in find_effects(effects):
            names += map(effect.qualified_name, amplitude_parameters(effect))
        return tuple(names)

    def ranges(self, names: Sequence[str]) -> np.ndarray:
        """Return lower and upper bounds (2, P) of parameters."""
        ranges = {p.name: (p.low, p.high) for p in self.model.parameters}
        return np.array([ranges[name] for name in names]).T

    def residuals(self, names: Sequence[str], x: np.ndarray) -> np.ndarray:
        """Return simulated minus seen positions of candidates, (C, N) [m].

        names: of parameters with values x (C, P); effects of the others are absent.
        """
        values = np.tile(self.model.values({}), (len(x), 1))
        values[:, [self.model.names.index(name) for name in names]] = x
        parts = []
        for trial in self.trials:
            shape = (len(x), len(trial.sightings.frame))
            parts.append(np.broadcast_to(trial.residuals(self.model, values), shape))
        return np.concatenate(parts, axis=1)

    def jacobian(self, names: Sequence[str], x: np.ndarray) -> np.ndarray:
        """Return the Jacobian (N, P) of the residuals over sigma at x (P,)."""
        low, high = self.ranges(names)
        step = DIFFERENCE_STEP * (high - low)
        middle = np.clip(x, low + step, high - step)
        ends = np.concatenate([middle + np.diag(step), middle - np.diag(step)])
        upper, lower = np.split(self.residuals(names, ends), 2)
        slopes = (upper - lower) / (2 * step[:, None])
        return slopes.T / self.sigma[:, None]


@dataclass(frozen=True)
class FreeParameters:
    """Free parameters of a problem for the solver, with fixed values of others."""

    problem: AlignmentProblem
    names: tuple[str, ...]
    fixed_values: Mapping[str, float]
    limit: float
    candidates_at_once: int = 1

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The free parameters, uniform in their ranges."""
        low, high = self.problem.ranges(self.names)
        return tuple(
            Parameter(name, "", "", least, most, 0.0)
            for name, least, most in zip(self.names, low, high, strict=True)
        )

    def residuals(self, chi: np.ndarray) -> np.ndarray:
        """Return residuals over sigma (C, N) of candidates chi (C, P)."""
        free = parameter_values(self.parameters, chi)
        fixed = np.tile(list(self.fixed_values.values()), (len(chi), 1))
        names = (*self.names, *self.fixed_values)
        residuals = self.problem.residuals(names, np.hstack([free, fixed]))
        return residuals / self.problem.sigma


@dataclass(frozen=True)
class AlignmentFit:
    """The best fit of an alignment.

    Attributes
    ----------
    effects
        Names of the fitted effects.
    names, x
        Qualified names of the parameters and their values (P,).
    width
        Widths of their ranges (P,).
    residual
        Residuals over sigma (N,).
    jacobian
        Derivative of the residuals by the parameters (N, P).
    limit
        Residual from which Huber's loss is linear.
    deviance
        Twice Huber's cost.
    blocks
        Time block of each residual (N,).
    """

    effects: tuple[str, ...]
    names: tuple[str, ...]
    x: np.ndarray
    width: np.ndarray
    residual: np.ndarray
    jacobian: np.ndarray
    limit: float
    deviance: float
    blocks: np.ndarray

    @property
    def values(self) -> dict[str, float]:
        """Values by qualified name."""
        return dict(zip(self.names, map(float, self.x), strict=True))

    @cached_property
    def weight(self) -> np.ndarray:
        """Huber's weight of each residual (N,)."""
        return huber_weights(self.residual, self.limit)

    @cached_property
    def _relative_covariance(self) -> Covariance:
        """Covariance of the parameters relative to the widths of their ranges."""
        jacobian = (self.jacobian * self.width).T
        return jackknife_covariance(jacobian, self.residual, self.weight, self.blocks)

    @property
    def covariance(self) -> np.ndarray:
        """Covariance of the parameters (P, P)."""
        return self._relative_covariance.matrix * np.outer(self.width, self.width)

    @property
    def half_widths(self) -> np.ndarray:
        """Half widths of the 95 % intervals (P,)."""
        return self._relative_covariance.half_width_95 * self.width

    @cached_property
    def inflation(self) -> float:
        """Mean factor by which correlated noise increases variances."""
        plain = np.linalg.pinv((self.weight[:, None] * self.jacobian).T @ self.jacobian)
        return float(np.mean(np.diag(self.covariance) / np.diag(plain)))


def fit_alignment(
    problem: AlignmentProblem,
    effects: Sequence[str],
    start: Mapping[str, float] | None = None,
    fixed: Mapping[str, float] | None = None,
    limit: float | None = None,
) -> AlignmentFit:
    """Fit the parameters of effects by robust least squares.

    start: initial values by qualified name; the others start at 0. fixed: values of
    parameters that are not fitted. limit: Huber's, of a fit whose deviance is compared;
    estimated by default.
    """
    start, fixed = start or {}, fixed or {}
    names = tuple(name for name in problem.parameters(effects) if name not in fixed)
    free = FreeParameters(problem, names, fixed, limit or np.inf)
    initial = np.array([start.get(name, 0.0) for name in names])
    chi = parameter_exponents(free.parameters, initial)
    for _ in range(MAX_SCALE_ROUNDS if limit is None else 1):
        scale = limit or HUBER_LIMIT * robust_sigma(free.residuals(chi[None]))
        free = replace(free, limit=scale)
        chi = solver.fit_least_squares(
            free, chi[None], min_gain=CONVERGENCE_TOLERANCE
        ).chi[0]
    residual = free.residuals(chi[None])[0]
    scale = limit or HUBER_LIMIT * robust_sigma(residual)
    low, high = problem.ranges(names)
    x = parameter_values(free.parameters, chi)
    all_x = np.array([*x, *fixed.values()])
    jacobian = problem.jacobian((*names, *fixed), all_x)
    return AlignmentFit(
        tuple(effects),
        names,
        x,
        width=high - low,
        residual=residual,
        jacobian=jacobian[:, : len(names)],
        limit=scale,
        deviance=len(residual) * float(huber_loss(residual, scale)),
        blocks=problem.blocks,
    )


def robust_sigma(residual: np.ndarray) -> float:
    """Return the standard deviation of residuals (N,) about zero, from their median."""
    # not zero, because residuals are divided by it
    return mad_sigma(residual) + 1e-12


def select_effects(problem: AlignmentProblem) -> AlignmentFit:
    """Fit the required effects, and add candidates while they improve the fit."""
    best = fit_alignment(problem, REQUIRED_EFFECTS)
    while True:
        candidates = [name for name in CANDIDATE_EFFECTS if name not in best.effects]
        fits = [add_effects(problem, best, name) for name in candidates]
        gains = [(best.deviance - fit.deviance) / best.inflation for fit in fits]
        if not gains or max(gains) < MIN_DEVIANCE_GAIN:
            return best
        extended = fits[int(np.argmax(gains))]
        best = fit_alignment(problem, extended.effects, extended.values)


def add_effects(
    problem: AlignmentProblem, fit: AlignmentFit, *effects: str
) -> AlignmentFit:
    """Fit further effects in addition, with the same Huber limit."""
    start = dict(fit.values)
    if "arm_lag" in effects:
        start |= {"arm_lag.time_constant": START_LAG_S}
        start["time_offset.offset"] += START_LAG_S
    return fit_alignment(problem, (*fit.effects, *effects), start, limit=fit.limit)
