"""The fit: what is seen of the arm against where the joints say that it is.

The forward model does it all: rotation, origin and scale of the picture and the offset
of the clocks are its effects, and so are the others that are looked for. Solver, robust
loss and covariance are those of every fit (`inference`).
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
TIME_BLOCKS = 20  # pieces into which the time is cut
DIFFERENCE_STEP = 1e-4  # of a parameter's range, for the central difference
# of the log-likelihood: an improvement that ends them, for deviances are compared
CONVERGENCE_TOLERANCE = 1e-3
MAX_ROUNDS = 3  # in which the robust scale settles
# deviance that an effect must explain to be seen: by chance 1 in 400
MIN_DEVIANCE_GAIN = 9.0
# [s] from which a lag is sought: at none it cannot be told from an offset
START_LAG_S = 0.004


def measurement_model(model: Model) -> Model:
    """The arm and camera of a model with every effect that alignment looks for, and no
    other.

    In the order of their names, in which the settings keep them: a turn and a shift do
    not commute.
    """
    return Model(model.string, model.arm, model.camera).with_effects(
        *find_effects(sorted((*REQUIRED_EFFECTS, *CANDIDATE_EFFECTS)))
    )


@dataclass(frozen=True)
class AlignmentProblem:
    """Trials that share one alignment. model: with every effect that is looked for, and
    nothing else.
    """

    model: Model
    trials: tuple[SightedTrial, ...]

    @cached_property
    def sigma(self) -> np.ndarray:
        """(N,) of all sightings [m]."""
        return np.concatenate([trial.sightings.sigma for trial in self.trials])

    @cached_property
    def times(self) -> np.ndarray:
        """(N,) of all sightings, by the camera's clock [s]."""
        return np.concatenate(
            [trial.sightings.times[trial.sightings.frame] for trial in self.trials]
        )

    @cached_property
    def blocks(self) -> np.ndarray:
        """(N,) number of the block of time in which each sighting lies; none reaches
        over two trials.
        """
        spans = [
            max(float(np.ptp(trial.sightings.times)), 1e-9) for trial in self.trials
        ]
        length = sum(spans) / TIME_BLOCKS
        parts, first = [], 0
        for trial, span in zip(self.trials, spans, strict=True):
            count = max(round(span / length), 1)
            # below 1 for the last one too, which then has a block
            share = (trial.sightings.times - trial.sightings.times[0]) / (
                span * (1 + 1e-9)
            )
            parts.append(first + (share * count).astype(int)[trial.sightings.frame])
            first += count
        return np.concatenate(parts)

    @staticmethod
    def parameters(effects: Sequence[str]) -> tuple[str, ...]:
        """Qualified names of the sizes of these effects: where and when they act is not
        asked.
        """
        return tuple(
            effect.qualified_name(p)
            for effect in find_effects(effects)
            for p in amplitude_parameters(effect)
        )

    def ranges(self, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of parameters."""
        found = {p.name: p for p in self.model.parameters}
        return np.array([found[n].low for n in names]), np.array(
            [found[n].high for n in names]
        )

    def residuals(self, names: Sequence[str], x: np.ndarray) -> np.ndarray:
        """Reported less seen positions of candidates x (C, P) of these parameters, the
        others absent, (C, N) [m].
        """
        values = np.tile(self.model.values({}), (len(x), 1))
        values[:, [self.model.names.index(name) for name in names]] = x
        parts = [
            np.broadcast_to(
                t.residuals(self.model, values), (len(x), len(t.sightings.frame))
            )
            for t in self.trials
        ]
        return np.concatenate(parts, axis=1)

    def jacobian(self, names: Sequence[str], x: np.ndarray) -> np.ndarray:
        """The Jacobian (N, P) of the residuals over sigma at x (P,)."""
        low, high = self.ranges(names)
        step = DIFFERENCE_STEP * (high - low)
        middle = np.clip(x, low + step, high - step)
        ends = self.residuals(
            names, np.concatenate([middle + np.diag(step), middle - np.diag(step)])
        )
        return ((ends[: len(x)] - ends[len(x) :]) / (2 * step[:, None])).T / self.sigma[
            :, None
        ]


@dataclass(frozen=True)
class FreeParameters:
    """Some parameters of a problem, as the solver asks for them. held: values of
    others.
    """

    problem: AlignmentProblem
    names: tuple[str, ...]
    fixed_values: Mapping[str, float]
    limit: float

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The free parameters, uniform in their ranges."""
        low, high = self.problem.ranges(self.names)
        return tuple(
            Parameter(n, "", "", a, b, 0.0)
            for n, a, b in zip(self.names, low, high, strict=True)
        )

    def residuals(self, chi: np.ndarray) -> np.ndarray:
        """Residuals over sigma (C, N) of candidates chi (C, P)."""
        values = parameter_values(self.parameters, chi)
        others = np.broadcast_to(
            np.array(list(self.fixed_values.values())),
            (len(chi), len(self.fixed_values)),
        )
        return (
            self.problem.residuals(
                (*self.names, *self.fixed_values), np.hstack([values, others])
            )
            / self.problem.sigma
        )


@dataclass(frozen=True)
class AlignmentFit:
    """Parameters that fit. effects: those at work. x: (P,) values; width: (P,) of their
    ranges. residual: (N,) over sigma. slope: (N, P). limit: size from which a residual
    counts less. deviance: twice Huber's cost.
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
        """(N,) Huber's."""
        return huber_weights(self.residual, self.limit)

    @cached_property
    def _relative_covariance(self) -> Covariance:
        """Covariance of the parameters as shares of their ranges."""
        return jackknife_covariance(
            (self.jacobian * self.width).T, self.residual, self.weight, self.blocks
        )

    @property
    def covariance(self) -> np.ndarray:
        """(P, P)."""
        return self._relative_covariance.matrix * np.outer(self.width, self.width)

    @property
    def half_widths(self) -> np.ndarray:
        """(P,) half widths of the 95 % intervals."""
        return self._relative_covariance.half_width_95 * self.width

    @cached_property
    def inflation(self) -> float:
        """The variance inflation factor of correlated noise, on average over the
        residuals.
        """
        plain = np.linalg.pinv((self.weight[:, None] * self.jacobian).T @ self.jacobian)
        return float(np.mean(np.diag(self.covariance) / np.diag(plain)))


def fit_alignment(
    problem: AlignmentProblem,
    effects: Sequence[str],
    start: Mapping[str, float] | None = None,
    held: Mapping[str, float] | None = None,
    limit: float | None = None,
) -> AlignmentFit:
    """The best parameters of these effects.

    start: values at which the search begins. held: values of parameters that are not
    fitted. limit: as of another fit, so that deviances can be compared; else it is
    found.
    """
    held = held or {}
    names = tuple(name for name in problem.parameters(effects) if name not in held)
    sought = FreeParameters(problem, names, held, limit or np.inf)
    chi = parameter_exponents(
        sought.parameters, np.array([(start or {}).get(name, 0.0) for name in names])
    )
    for _ in range(MAX_ROUNDS if limit is None else 1):
        scale = limit or HUBER_LIMIT * robust_sigma(sought.residuals(chi[None]))
        chi = solver.fit_least_squares(
            replace(sought, limit=scale), chi[None], enough=CONVERGENCE_TOLERANCE
        ).chi[0]
    residual = sought.residuals(chi[None])[0]
    scale = limit or HUBER_LIMIT * robust_sigma(residual)
    low, high = problem.ranges(names)
    x = parameter_values(sought.parameters, chi)
    slope = problem.jacobian((*names, *held), np.array([*x, *held.values()]))[
        :, : len(names)
    ]
    deviance = len(residual) * float(huber_loss(residual, scale))
    return AlignmentFit(
        tuple(effects),
        names,
        x,
        high - low,
        residual,
        slope,
        scale,
        deviance,
        problem.blocks,
    )


def robust_sigma(residual: np.ndarray) -> float:
    """Standard deviation about zero of residuals (N,), from their median, in their
    unit.
    """
    # never zero, for residuals are divided by it
    return float(mad_sigma(residual)) + 1e-12


def select_effects(problem: AlignmentProblem) -> AlignmentFit:
    """The fit with all that is always measured, and those of the effects sought that
    make a difference.
    """
    best = fit_alignment(problem, REQUIRED_EFFECTS)
    while True:
        others = [name for name in CANDIDATE_EFFECTS if name not in best.effects]
        tried = [add_effects(problem, best, name) for name in others]
        gains = [(best.deviance - other.deviance) / best.inflation for other in tried]
        if not gains or max(gains) < MIN_DEVIANCE_GAIN:
            return best
        further = tried[int(np.argmax(gains))]
        best = fit_alignment(problem, further.effects, further.values)


def add_effects(
    problem: AlignmentProblem, fit: AlignmentFit, *effects: str
) -> AlignmentFit:
    """The fit with further effects at work, judged by the same limit."""
    start = dict(fit.values)
    if "arm_lag" in effects:
        start |= {"arm_lag.time_constant": START_LAG_S}
        start["time_offset.offset"] += START_LAG_S
    return fit_alignment(problem, (*fit.effects, *effects), start, limit=fit.limit)
