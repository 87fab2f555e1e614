"""How a string lies and moves at a moment, as the start of a simulation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from stages.model.string import String


@dataclass(frozen=True)
class State:
    """A curve hung from the grasp, and how it turns: the string's state but for its strain.

    A string hardly stretches, so its shape and motion are the direction phi(s) of its segments and how fast it
    turns. A start in these goes along with the hand, wherever a candidate's hand is, and cannot set the string
    ringing along itself by noise; its stretch each candidate finds from its own tension.

    t: when [s], one moment or one for each candidate, (C,). s: (M,) rest arc lengths, increasing [m].
    angle: (M,) direction there, continuous from the grasp's [rad]. rate: (M,) its time derivative [rad/s]. Both may
    be each candidate's own, (C, M).
    """

    t: float | np.ndarray
    s: np.ndarray
    angle: np.ndarray
    rate: np.ndarray

    def at(self, t: float | np.ndarray) -> State:
        """The same state at another time, of another clock for instance."""
        return replace(self, t=t)

    def counted(self, times: np.ndarray) -> np.ndarray:
        """Times (F,) or (C, F) [s] as they count from here on: as before, or from each candidate's own start."""
        return times if np.ndim(self.t) == 0 else times - np.asarray(self.t)[:, None]

    def of(self, chosen: np.ndarray | slice) -> State:
        """Of some candidates, whose numbers are given."""
        t = self.t if np.ndim(self.t) == 0 else np.asarray(self.t)[chosen]
        angle, rate = (each if each.ndim == 1 else each[chosen] for each in (self.angle, self.rate))
        return replace(self, t=t, angle=angle, rate=rate)

    def segments(self, string: String) -> tuple[np.ndarray, np.ndarray]:
        """Angles [rad] and their rates [rad/s] of a string's segments, (n - 1,) each, or (C, n - 1)."""
        along = partial(np.interp, string.middles(), self.s)
        return np.apply_along_axis(along, -1, self.angle), np.apply_along_axis(along, -1, self.rate)
