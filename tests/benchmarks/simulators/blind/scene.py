"""The measurements of a bench, and how much of them other base parameters could
explain.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import lsq_linear

from stringcast.stages.model.arm import Arm
from stringcast.stages.model.camera import Camera
from stringcast.stages.model.effect import Effect, StringEffect
from stringcast.stages.model.engine.implicit_leapfrog import ImplicitLeapfrog
from stringcast.stages.model.engine.stability import steps_per_tick
from stringcast.stages.model.model import Model
from stringcast.stages.model.string import PAPER_EFFECTS, String
from tests.benchmarks.simulators.blind.casts import FINE, Cast
from tests.benchmarks.simulators.blind.version import Version

# of what really hangs there: a tip that cracks is then a quarter of a sigma off, with
# 40 points four
POINTS = 160
LARGEST_STEP = 1e-4  # [s] of what really hangs there
STEP = 1e-4  # of chi, for differences
EDGE = 1e-12  # what lies on a bound is allowed a little, or there would be no inside
# of a Gauss-Newton step, of which the best is taken
SHARES = np.array([1.0, 0.5, 0.25, 0.1])
Values = Mapping[str, float]


@dataclass(frozen=True)
class Scene:
    """A string, its casts and a camera. base: the paper's parameters by name. s: (S,)
    arc lengths at which points are measured [m]. sigma: of their noise, in x and in y
    [m]. version: what may be hidden in it.
    """

    arm: Arm
    camera: Camera
    length: float
    base: Mapping[str, float]
    casts: tuple[Cast, ...]
    s: np.ndarray
    sigma: float
    version: Version

    @property
    def fine(self) -> String:
        """The true string, whose own errors must be less than what a diagnosis
        resolves.
        """
        return replace(self.second_order(POINTS), largest_step=LARGEST_STEP)

    def second_order(self, points: int) -> String:
        """The string as `string=fine` simulates it, with which sizes are sought: the
        true one takes a hundred times as long.
        """
        return String(
            self.length,
            points,
            tip_cell=0.5,
            grasp_cell=0.5,
            integrator=ImplicitLeapfrog(),
            largest_step=5e-4,
        )

    def model(self, string: String, hidden: Sequence[type[Effect]] = ()) -> Model:
        """A string in this scene with effects. With one on the string come all that
        there are, mostly at zero, so that there is one loop to compile whatever a seed
        draws, and no other bits when the library grows.
        """
        elsewhere = [e for e in hidden if not issubclass(e, StringEffect)]
        if len(elsewhere) < len(hidden):
            causes = (*self.version.library(), *self.version.causes())
            string = replace(
                string,
                effects=(
                    *PAPER_EFFECTS,
                    *(e for e in causes if issubclass(e, StringEffect)),
                ),
            )
        return Model(string, self.arm, self.camera).with_effects(*elsewhere)

    def performing(self, casts: tuple[Cast, ...]) -> Scene:
        """The same scene in which these casts are performed."""
        return replace(self, casts=casts)

    def seen(
        self, model: Model, values: Sequence[Values], only: int | None = None
    ) -> np.ndarray:
        """Points as measured without noise, in sigmas, (C, N, S, 2); NaN for a run that
        fails.

        values: of each candidate by name, beside the base. only: the one trial in which
        what is beyond the base acts.
        """
        parts = []
        for number, cast in enumerate(self.casts):
            acting = only is None or number == only
            # Where nothing hidden acts, parameters beyond the paper's, whose names have
            # a dot, are at zero.
            own = (
                values
                if acting
                else [{n: x for n, x in v.items() if "." not in n} for v in values]
            )
            rows = np.stack([model.values({**self.base, **v}) for v in own])
            points = model.simulate_observation(cast.happened, rows, cast.frames).points
            # at the arc lengths s, linear between mass points
            position = np.clip(
                self.s / self.length * (points.shape[2] - 1),
                0,
                points.shape[2] - 1 - 1e-9,
            )
            before, share = position.astype(int), (position % 1)[:, None]
            parts.append(
                points[:, :, before] * (1 - share) + points[:, :, before + 1] * share
            )
        return np.concatenate(parts, axis=1) / self.sigma

    def steps(self, model: Model, values: Values) -> int:
        """The number of steps into which a millisecond is divided, so that the model
        stays finite with these values.
        """
        rows = model.values({**self.base, **values})[
            None, : len(model.string.parameters)
        ]
        return int(
            steps_per_tick(model.string, model.string.material(rows), FINE)[0][0]
        )

    def left(
        self,
        model: Model,
        data: np.ndarray,
        free: Sequence[str],
        start: Values,
        steps: int,
        only: int | None = None,
    ) -> tuple[np.ndarray, dict[str, float]]:
        """The residual of data (N, S, 2) once the free parameters are fitted to it by
        bounded Gauss-Newton steps.

        Returns residuals in sigmas (N, S, 2), and the values fitted.
        """
        own = {p.name: p for p in model.parameters}
        values = {**self.base, **start}
        for _ in range(steps):
            chi = np.array([own[name].chi(np.array(values[name])) for name in free])
            now, slopes = self.slopes(model, values, free, only)
            q, r = np.linalg.qr(slopes.reshape(len(free), -1).T)
            within = (-chi - EDGE, 1 - chi + EDGE)  # chi stays in [0, 1]
            step = lsq_linear(r, q.T @ (data - now).ravel(), bounds=within).x
            moved = np.clip(chi + SHARES[:, None] * step, 0, 1)
            tried = [
                values
                | {n: float(own[n].value(c)) for n, c in zip(free, row, strict=True)}
                for row in moved
            ]
            misfit = np.mean(
                (self.seen(model, tried, only) - data) ** 2, axis=(1, 2, 3)
            )
            best = int(np.nanargmin(np.where(np.isfinite(misfit), misfit, np.inf)))
            if misfit[best] >= np.mean((now - data) ** 2):
                break
            values = tried[best]
        return data - self.seen(model, [values], only)[0], values

    def slopes(
        self, model: Model, values: Values, free: Sequence[str], only: int | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Points (N, S, 2) and their slopes with chi of each free parameter, (P, N, S,
        2), in sigmas.
        """
        own = {p.name: p for p in model.parameters}
        moved, width = [dict(values)], []
        for name in free:
            chi = float(own[name].chi(np.array(values[name])))
            ends = np.clip([chi - STEP, chi + STEP], 0, 1)
            width.append(float(np.diff(ends)[0]))
            moved += [{**values, name: float(own[name].value(end))} for end in ends]
        field = self.seen(model, moved, only)
        return field[0], (field[2::2] - field[1::2]) / np.array(width)[
            :, None, None, None
        ]

    def at_tip(self, field: np.ndarray) -> float:
        """The largest displacement of the tip, in sigmas. field: (N, S, 2)."""
        return float(np.linalg.norm(field[:, -1], axis=-1).max())


def unexplained(field: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Fields (C, N, S, 2) less their projections on columns (P, N, S, 2)."""
    q, _ = np.linalg.qr(columns.reshape(len(columns), -1).T)
    flat = field.reshape(len(field), -1)
    return (flat - (flat @ q) @ q.T).reshape(field.shape)
