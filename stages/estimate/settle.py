"""The state in which a trial begins, corrected by how the string then moves.

A few frames tell velocities to 0.1 m/s, which after half a swing is centimetres. Once parameters are
known about well enough, the motion that follows tells more: shape and turning rates are corrected
by smooth modes of a string that is held at one end, as far as the first part of the trial asks for it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from stringcast.stages.common import mad_sigma
from stringcast.stages.estimate.forward import Case
from stringcast.stages.model.state import State

SPAN = 0.5  # [s] of the trial's beginning that is looked at
MODES = 6
TURN = 0.1  # [rad] by which a mode of the shape may well be off
RATE = 3.0  # [rad/s] by which a mode of the rates may
STEP = 1e-3  # of those, for the differences
HUBER = 2.0  # robust scales beyond which a residual counts less
TRIES = 20  # steps at most; it mostly takes 5
UNCHANGED = np.zeros((1, 2 * MODES))
BESIDE = np.concatenate([UNCHANGED, STEP * np.eye(2 * MODES)])  # changes for the differences


def settled(ready: Case, values: np.ndarray) -> Case:
    """The case with the initial state that suits these parameters (P,) best; as it is where it begins at rest, or where
    the string cannot be simulated with them."""
    if ready.initial is None:
        return ready
    early = ready.until(min(SPAN / float(np.ptp(ready.times)), 1.0))
    noise = float(mad_sigma(_residuals(early, values, UNCHANGED)[0])) + 1e-12
    if not np.isfinite(noise):
        return ready

    def mismatch(changes: np.ndarray) -> np.ndarray:
        """(C, 2 N + M) for changes (C, M)."""
        return np.hstack([np.nan_to_num(_residuals(early, values, changes), nan=1e6) / noise, changes])

    found = least_squares(
        lambda change: mismatch(change[None])[0],
        UNCHANGED[0],
        jac=lambda change: _differences(mismatch(change + BESIDE)),
        loss="huber",
        f_scale=HUBER,
        x_scale=1.0,
        max_nfev=TRIES,
    )
    return replace(ready, initial=_changed(ready.initial, found.x, ready.model.string.length))


def slopes(ready: Case, values: np.ndarray) -> np.ndarray:
    """How the measured points move with the modes of the state in which the trial begins, a column each, (2 N, M) [m];
    none where it begins at rest, nor for what cannot be simulated. values: (P,)."""
    if ready.initial is None:
        return np.empty((2 * len(ready.points), 0))
    columns = _differences(_residuals(replace(ready, sigma=np.ones(len(ready.points))), values, BESIDE))
    return columns[:, np.isfinite(columns).all(axis=0)]


def _differences(rows: np.ndarray) -> np.ndarray:
    """Slopes (N, M) from rows (1 + M, N), with the changes of BESIDE."""
    here, *beside = rows
    return (np.stack(beside, axis=1) - here[:, None]) / STEP


def _residuals(ready: Case, values: np.ndarray, changes: np.ndarray) -> np.ndarray:
    """Simulated less measured over sigma, (C, 2 N), with each of the changes (C, M) of the state at the beginning."""
    assert ready.initial is not None
    moved = replace(ready, initial=_changed(ready.initial, changes, ready.model.string.length))
    _, motion = next(moved.simulate(np.repeat(values[None], len(changes), axis=0)))
    return ((moved.at_measured(motion) - ready.points) / ready.sigma[:, None]).reshape(len(changes), -1)


def _changed(state: State, change: np.ndarray, length: float) -> State:
    """The state with modes added: sin((k - 1/2) pi s / L) of the angles and of the rates. change: (2 MODES,), or one
    for each candidate, (C, 2 MODES)."""
    modes = np.sin((np.arange(MODES)[:, None] + 0.5) * np.pi * state.s / length)
    turn, rate = TURN * change[..., :MODES] @ modes, RATE * change[..., MODES:] @ modes
    return replace(state, angle=state.angle + turn, rate=state.rate + rate)
