"""How a string lies and moves at a moment, as the start of a simulation."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class StringState:
    """A curve hung from the grasp, and how it turns: the string's state but for its
    strain.

    A string hardly stretches, so its shape and motion are the direction phi(s) of its
    segments and how fast it turns. A start in these goes along with the hand, wherever
    a candidate's hand is, and cannot set the string ringing along itself by noise; its
    stretch each candidate finds from its own tension.

    t: when [s], one moment or one for each candidate, (C,). s: (M,) rest arc lengths
    from the stated grasp, increasing [m]. angle: (M,) direction there, continuous from
    the grasp's [rad]. rate: (M,) its time derivative [rad/s]. All three may be each
    candidate's own, (C, M). let_back: what hinges with a memory hold as it begins, as a
    share of the way from what they hold after a slow pull to this shape, 0, to what
    they hold once bent far back, 1; (C,), too.
    """

    t: float | np.ndarray
    s: np.ndarray
    angle: np.ndarray
    rate: np.ndarray
    memory_reversal: float | np.ndarray = 0.0

    def with_time(self, t: float | np.ndarray) -> StringState:
        """The state at another time, of another clock for instance."""
        return replace(self, t=t)

    def times_since_start(self, times: np.ndarray) -> np.ndarray:
        """Times (F,) or (C, F) [s] as they count from here on: as before, or from each
        candidate's own start.
        """
        return times if np.ndim(self.t) == 0 else times - np.asarray(self.t)[:, None]

    def for_candidates(self, chosen: np.ndarray | slice) -> StringState:
        """The states of some candidates, by number."""
        t, let_back = (
            each if np.ndim(each) == 0 else np.asarray(each)[chosen]
            for each in (self.t, self.memory_reversal)
        )
        s, angle, rate = (
            each if each.ndim == 1 else each[chosen]
            for each in (self.s, self.angle, self.rate)
        )
        return StringState(t, s, angle, rate, let_back)

    def extend_before_grasp(
        self, before: np.ndarray, direction: np.ndarray, turning: np.ndarray
    ) -> StringState:
        """The state of a string that begins before the stated grasp, by (C,) [m]: it
        bends evenly, to a direction [rad] that turns at a rate [rad/s], (C,) each.
        """

        def grown(end: np.ndarray, part: np.ndarray) -> np.ndarray:
            rows = np.broadcast_to(part, (len(before), part.shape[-1]))
            return np.column_stack([np.broadcast_to(end, len(before)), rows])

        first = np.minimum(-before, self.s[..., 0])
        angle, rate = grown(direction, self.angle), grown(turning, self.rate)
        return replace(self, s=grown(first, self.s), angle=angle, rate=rate)

    def segment_angles_and_rates(
        self, middles: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Angles [rad] and their rates [rad/s] of segments whose middles are at (M,) or
        (C, M) [m], of that shape.
        """
        return _interpolate(middles, self.s, self.angle), _interpolate(
            middles, self.s, self.rate
        )


def _interpolate(x: np.ndarray, nodes: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values at x between their nodes, as np.interp, each (M,) or of all candidates (C,
    M).
    """
    if x.ndim == nodes.ndim == values.ndim == 1:
        return np.interp(x, nodes, values)
    count = max(len(each) for each in (x, nodes, values) if each.ndim == 2)
    rows = (
        np.broadcast_to(each, (count, each.shape[-1])) for each in (x, nodes, values)
    )
    return np.array([np.interp(*row) for row in zip(*rows, strict=True)])
