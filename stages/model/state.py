"""Initial state of a string: its shape and motion at one time."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class StringState:
    """Direction and turn rate of a string along its arc, without strain.

    A string hardly stretches, so the direction phi(s) of its segments and its rate
    describe shape and motion. Such a state fits every candidate's hand, and its noise
    does not excite axial vibration. Each candidate computes the stretch from its own
    tension.

    Parameters
    ----------
    t : float or ndarray of shape (C,)
        When [s].
    s : ndarray of shape (M,) or (C, M)
        Rest arc lengths from the stated grasp, increasing [m].
    angle : ndarray of shape (M,) or (C, M)
        Directions at `s`, unwrapped from the grasp [rad].
    rate : ndarray of shape (M,) or (C, M)
        Time derivatives of `angle` [rad/s].
    memory_reversal : float or ndarray of shape (C,)
        Memory of the hinges: 0 after a slow pull to this shape, 1 after bending far
        back; linear between.
    """

    t: float | np.ndarray
    s: np.ndarray
    angle: np.ndarray
    rate: np.ndarray
    memory_reversal: float | np.ndarray = 0.0

    def times_since_start(self, times: np.ndarray) -> np.ndarray:
        """Convert times (F,) or (C, F) [s] to those of a simulation from this state.

        They do not change if all candidates share a start time. Otherwise they count
        from each candidate's own start.
        """
        if np.ndim(self.t) == 0:
            return times
        return times - np.asarray(self.t)[:, None]

    def for_candidates(self, chosen: np.ndarray | slice) -> StringState:
        """Return the states of some candidates, by number."""
        return StringState(
            _select(self.t, chosen, 0),
            np.asarray(_select(self.s, chosen, 1)),
            np.asarray(_select(self.angle, chosen, 1)),
            np.asarray(_select(self.rate, chosen, 1)),
            _select(self.memory_reversal, chosen, 0),
        )

    def extend_before_grasp(
        self, before: np.ndarray, direction: np.ndarray, turning: np.ndarray
    ) -> StringState:
        """Extend the state to a string that begins before the stated grasp.

        The curvature of the added part is constant.

        Parameters
        ----------
        before : ndarray of shape (C,)
            Length before the grasp [m].
        direction, turning : ndarray of shape (C,)
            Direction at the new beginning [rad], and its rate [rad/s].
        """
        first = np.minimum(-before, self.s[..., 0])
        return replace(
            self,
            s=_prepend(first, self.s, len(before)),
            angle=_prepend(direction, self.angle, len(before)),
            rate=_prepend(turning, self.rate, len(before)),
        )

    def segment_angles_and_rates(
        self, middles: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Find angles [rad] and their rates [rad/s] of segments.

        middles: arc lengths of the segments' middles, (M,) or (C, M) [m].
        """
        angles = _interpolate(middles, self.s, self.angle)
        return angles, _interpolate(middles, self.s, self.rate)


def _select(
    value: float | np.ndarray, chosen: np.ndarray | slice, shared_dimensions: int
) -> float | np.ndarray:
    """Select candidates of a value, unless all share it."""
    if np.ndim(value) == shared_dimensions:
        return value
    return np.asarray(np.asarray(value)[chosen])


def _prepend(first: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    rows = np.broadcast_to(values, (count, values.shape[-1]))
    return np.column_stack([np.broadcast_to(first, count), rows])


def _interpolate(x: np.ndarray, nodes: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Interpolate values at x between nodes, each (M,) or (C, M)."""
    if x.ndim == nodes.ndim == values.ndim == 1:
        return np.interp(x, nodes, values)
    arrays = (x, nodes, values)
    count = max(len(array) for array in arrays if array.ndim == 2)
    rows = [np.broadcast_to(array, (count, array.shape[-1])) for array in arrays]
    return np.array([np.interp(*row) for row in zip(*rows, strict=True)])
