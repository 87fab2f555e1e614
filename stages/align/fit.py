"""The fit: what is seen of the arm against where the joints say that it is.

The forward model does it all: rotation, origin and scale of the picture and the offset of the clocks are its effects,
and so are the others that are looked for. Robust least squares (Huber); the covariance is a jackknife over blocks of
time, for what neighbouring frames get wrong they get wrong together (Künsch 1989), of one Newton step each.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import least_squares
from scipy.special import stdtrit

from stringcast.stages.align.sightings import Sighted
from stringcast.stages.common import mad_sigma
from stringcast.stages.model.effect import components
from stringcast.stages.model.library import named
from stringcast.stages.model.model import Model

ALWAYS = ("time_offset", "camera_rotation", "pixel_scale", "camera_offset")
SOUGHT = ("arm_lag", "clock_drift", "rolling_shutter", "lens_distortion")
BLOCKS = 20  # pieces into which the time is cut
STEP = 1e-4  # of a parameter's range, for the central difference
HUBER = 2.0  # robust scales beyond which a residual counts less
ROUNDS = 3  # in which the robust scale settles
SURE = 9.0  # deviance that an effect must explain to be seen: by chance 1 in 400
LAGGING = 0.004  # [s] from which a lag is sought: at none it cannot be told from an offset


def measuring(model: Model) -> Model:
    """The arm and camera of a model with every effect that alignment looks for, and no other.

    In the order of their names, in which the settings keep them: a turn and a shift do not commute.
    """
    return Model(model.string, model.arm, model.camera).with_effects(*named(sorted((*ALWAYS, *SOUGHT))))


@dataclass(frozen=True)
class Problem:
    """Trials that share one alignment. model: with every effect that is looked for, and nothing else."""

    model: Model
    trials: tuple[Sighted, ...]

    @cached_property
    def sigma(self) -> np.ndarray:
        """(N,) of all sightings [m]."""
        return np.concatenate([trial.sightings.sigma for trial in self.trials])

    @cached_property
    def times(self) -> np.ndarray:
        """(N,) of all sightings, by the camera's clock [s]."""
        return np.concatenate([trial.sightings.times[trial.sightings.frame] for trial in self.trials])

    @cached_property
    def blocks(self) -> np.ndarray:
        """(N,) number of the block of time in which each sighting lies; none reaches over two trials."""
        spans = [max(float(np.ptp(trial.sightings.times)), 1e-9) for trial in self.trials]
        length = sum(spans) / BLOCKS
        parts, first = [], 0
        for trial, span in zip(self.trials, spans, strict=True):
            count = max(round(span / length), 1)
            share = (trial.sightings.times - trial.sightings.times[0]) / (span * (1 + 1e-9))
            parts.append(first + (share * count).astype(int)[trial.sightings.frame])
            first += count
        return np.concatenate(parts)

    @staticmethod
    def parameters(effects: Sequence[str]) -> tuple[str, ...]:
        """Qualified names of the sizes of these effects: where and when they act is not asked."""
        return tuple(effect.qualified(p) for effect in named(effects) for p in components(effect))

    def ranges(self, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of parameters."""
        found = {p.name: p for p in self.model.parameters}
        return np.array([found[n].low for n in names]), np.array([found[n].high for n in names])

    def off(self, names: Sequence[str], x: np.ndarray) -> np.ndarray:
        """Told less seen of candidates x (C, P) of these parameters, the others absent, (C, N) [m]."""
        values = np.tile(self.model.values({}), (len(x), 1))
        values[:, [self.model.names.index(name) for name in names]] = x
        parts = [np.broadcast_to(t.off(self.model, values), (len(x), len(t.sightings.frame))) for t in self.trials]
        return np.concatenate(parts, axis=1)

    def slopes(self, names: Sequence[str], x: np.ndarray) -> np.ndarray:
        """How the residuals over sigma change with x (P,), (N, P)."""
        low, high = self.ranges(names)
        step = STEP * (high - low)
        middle = np.clip(x, low + step, high - step)
        ends = self.off(names, np.concatenate([middle + np.diag(step), middle - np.diag(step)]))
        return ((ends[: len(x)] - ends[len(x) :]) / (2 * step[:, None])).T / self.sigma[:, None]


@dataclass(frozen=True)
class Fit:
    """Parameters that fit. effects: those at work. x: (P,) values. residual: (N,) over sigma. slope: (N, P). limit:
    size from which a residual counts less. deviance: twice Huber's cost."""

    effects: tuple[str, ...]
    names: tuple[str, ...]
    x: np.ndarray
    residual: np.ndarray
    slope: np.ndarray
    limit: float
    deviance: float
    blocks: np.ndarray

    @property
    def values(self) -> dict[str, float]:
        """By qualified name."""
        return dict(zip(self.names, map(float, self.x), strict=True))

    @cached_property
    def weight(self) -> np.ndarray:
        """(N,) Huber's."""
        return np.minimum(1.0, self.limit / np.maximum(np.abs(self.residual), 1e-300))

    @cached_property
    def covariance(self) -> np.ndarray:
        """(P, P) by leaving out each block of time in turn."""
        weighted = self.weight[:, None] * self.slope
        numbers = np.unique(self.blocks)
        inside = [self.blocks == number for number in numbers]
        normal = weighted.T @ self.slope
        moves = np.stack(
            [
                np.linalg.lstsq(
                    normal - weighted[own].T @ self.slope[own], weighted[own].T @ self.residual[own], rcond=None
                )[0]
                for own in inside
            ]
        )
        moves = moves - moves.mean(axis=0)
        return (len(numbers) - 1) / len(numbers) * moves.T @ moves

    @cached_property
    def reach(self) -> np.ndarray:
        """(P,) half widths of the 95 % intervals."""
        free = max(len(np.unique(self.blocks)) - 1, 1)
        return stdtrit(free, 0.975) * np.sqrt(np.diag(self.covariance))

    @cached_property
    def inflation(self) -> float:
        """How much wider the noise's correlation makes variances than its sigma says, on average."""
        plain = np.linalg.pinv((self.weight[:, None] * self.slope).T @ self.slope)
        return float(np.mean(np.diag(self.covariance) / np.diag(plain)))


def fitted(
    problem: Problem,
    effects: Sequence[str],
    start: Mapping[str, float] | None = None,
    held: Mapping[str, float] | None = None,
    limit: float | None = None,
) -> Fit:
    """The best parameters of these effects.

    start: values at which the search begins. held: values of parameters that are not fitted. limit: as of another fit,
    so that deviances can be compared; else it is found.
    """
    held = held or {}
    names = tuple(name for name in problem.parameters(effects) if name not in held)
    low, high = problem.ranges(names)
    x = np.clip([(start or {}).get(name, 0.0) for name in names], low, high)
    fixed = np.array(list(held.values()))

    def residual(x: np.ndarray) -> np.ndarray:
        return problem.off((*names, *held), np.concatenate([x, fixed])[None])[0] / problem.sigma

    def slope(x: np.ndarray) -> np.ndarray:
        return problem.slopes((*names, *held), np.concatenate([x, fixed]))[:, : len(names)]

    for _ in range(ROUNDS if limit is None else 1):
        scale = limit or HUBER * robust(residual(x))
        found = least_squares(
            residual, x, slope, (low - 1e-12, high + 1e-12), x_scale="jac", loss="huber", f_scale=scale
        )
        x = found.x
    scale = limit or HUBER * robust(residual(x))
    own = residual(x)
    within = np.minimum(np.abs(own), scale)
    deviance = float(np.sum(within * (2 * np.abs(own) - within)))
    return Fit(tuple(effects), names, x, own, slope(x), scale, deviance, problem.blocks)


def robust(residual: np.ndarray) -> float:
    """Robust standard deviation about zero."""
    return float(mad_sigma(residual)) + 1e-12


def chosen(problem: Problem) -> Fit:
    """The fit with all that is always measured, and those of the effects sought that make a difference."""
    best = fitted(problem, ALWAYS)
    while True:
        others = [name for name in SOUGHT if name not in best.effects]
        tried = [more(problem, best, name) for name in others]
        gains = [(best.deviance - other.deviance) / best.inflation for other in tried]
        if not gains or max(gains) < SURE:
            return best
        further = tried[int(np.argmax(gains))]
        best = fitted(problem, further.effects, further.values)


def more(problem: Problem, fit: Fit, *effects: str) -> Fit:
    """The fit with further effects at work, judged by the same limit."""
    start = dict(fit.values)
    if "arm_lag" in effects:
        start |= {"arm_lag.time_constant": LAGGING}
        start["time_offset.offset"] += LAGGING
    return fitted(problem, (*fit.effects, *effects), start, limit=fit.limit)
