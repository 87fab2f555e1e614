"""The state in which a trial begins, corrected by how the string then moves.

A few frames tell velocities to 0.1 m/s, which after half a swing is centimetres. Once parameters are
known about well enough, the motion that follows tells more: shape and turning rates are corrected
by smooth modes of a string that is held at one end, as far as the first part of the trial asks for it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from stages.estimate.forward import Case
from stages.model.state import State
from stages.spread import spread

SPAN = 0.5  # [s] of the trial's beginning that is looked at
MODES = 6
TURN = 0.1  # [rad] by which a mode of the shape may well be off
RATE = 3.0  # [rad/s] by which a mode of the rates may
STEP = 1e-3  # of those, for the differences
HUBER = 2.0  # robust scales beyond which a residual counts less
TRIES = 20  # steps at most; it mostly takes 5


def settled(ready: Case, values: np.ndarray) -> Case:
    """The case with the initial state that suits these parameters (P,) best; as it is where it begins at rest, or where
    the string cannot be simulated with them."""
    if ready.initial is None:
        return ready
    begin = ready.initial
    early = ready.until(min(SPAN / float(np.ptp(ready.times)), 1.0))
    noise = float(spread(_residual(early, values))) + 1e-12
    if not np.isfinite(noise):
        return ready

    def mismatch(change: np.ndarray) -> np.ndarray:
        moved = replace(early, initial=_changed(begin, change, ready.model.string.length))
        return np.concatenate([np.nan_to_num(_residual(moved, values), nan=1e6) / noise, change])

    found = least_squares(
        mismatch, np.zeros(2 * MODES), loss="huber", f_scale=HUBER, diff_step=STEP, x_scale=1.0, max_nfev=TRIES
    )
    return replace(ready, initial=_changed(begin, found.x, ready.model.string.length))


def slopes(ready: Case, values: np.ndarray) -> np.ndarray:
    """How the measured points move with the modes of the state in which the trial begins, a column each, (2 N, M) [m];
    none where it begins at rest, nor for what cannot be simulated. values: (P,)."""
    begin = ready.initial
    if begin is None:
        return np.empty((2 * len(ready.points), 0))
    metres = replace(ready, sigma=np.ones(len(ready.points)))
    changes = STEP * np.eye(2 * MODES)
    moved = [replace(metres, initial=_changed(begin, change, ready.model.string.length)) for change in changes]
    here = _residual(metres, values)
    columns = np.stack([_residual(each, values) - here for each in moved], axis=1) / STEP
    return columns[:, np.isfinite(columns).all(axis=0)]


def _residual(ready: Case, values: np.ndarray) -> np.ndarray:
    """Simulated less measured, over sigma, (2 N,)."""
    _, motion = next(ready.simulate(values[None]))
    return ((ready.at_measured(motion)[0] - ready.points) / ready.sigma[:, None]).ravel()


def _changed(state: State, change: np.ndarray, length: float) -> State:
    """The state with modes added: sin((k - 1/2) pi s / L) of the angles and of the rates. change: (2 MODES,)."""
    modes = np.sin((np.arange(MODES)[:, None] + 0.5) * np.pi * state.s / length)
    turn, rate = TURN * change[:MODES] @ modes, RATE * change[MODES:] @ modes
    return replace(state, angle=state.angle + turn, rate=state.rate + rate)
