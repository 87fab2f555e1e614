"""A real arm's velocity loop: joints follow their commands, but not at once and not
exactly.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate

import numpy as np


@dataclass(frozen=True)
class VirtualServo:
    """The velocity loop of each joint, and its encoder.

    bandwidth: where the loop's gain has fallen by 3 dB [Hz]. resolution: one count of
    the encoder [rad]. repeatability: how differently two performances turn out, one
    sigma of the speed's relative error.
    """

    bandwidth: float = 40.0
    resolution: float = 2 * np.pi / 65536
    repeatability: float = 0.002
    step: float = 0.0005

    def follow_commands(
        self, t: np.ndarray, speeds: np.ndarray, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """The joints' motion under commands held from tick to tick: fine times (K,) [s]
        and angles turned since the start (K, J) [rad]. t: (N,) [s]. speeds: (N, J)
        commanded [rad/s].
        """
        fine = np.arange(t[0], t[-1] + self.step / 2, self.step)
        # a command acts from its very tick on, whatever the rounding
        held = speeds[
            np.clip(np.searchsorted(t, fine + 1e-9, side="right") - 1, 0, len(t) - 1)
        ]
        held = held * (1 + self.repeatability * rng.standard_normal(speeds.shape[1]))
        # two equal poles p: -3 dB of 1 / (s / p + 1)^2 is at p sqrt(sqrt(2) - 1)
        pole = np.exp(-2 * np.pi * self.bandwidth / np.sqrt(np.sqrt(2) - 1) * self.step)
        real = held
        for _ in range(2):
            # y_k = (1 - p) x_k + p y_{k-1}: SciPy has it too, and takes half a second
            # to load
            real = np.array(
                list(
                    accumulate(
                        (1 - pole) * real, lambda before, new: new + pole * before
                    )
                )
            )
        return fine, np.concatenate(
            [np.zeros((1, speeds.shape[1])), np.cumsum(real[:-1], axis=0) * self.step]
        )

    def encoder_reading(self, angles: np.ndarray) -> np.ndarray:
        """The encoder's reading of angles of any shape [rad], in whole counts."""
        return np.round(angles / self.resolution) * self.resolution
