"""The velocity loop of an arm, whose joints follow commands late and inexactly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class VirtualServo:
    """The velocity loop of each joint, and its encoder.

    Attributes
    ----------
    bandwidth
        Frequency at which the loop's gain has fallen by 3 dB [Hz].
    resolution
        One count of the encoder [rad].
    repeatability
        Relative error of the speed from one performance to the next, one sigma.
    step
        Time step of the simulation [s].
    """

    bandwidth: float = 40.0
    resolution: float = 2 * np.pi / 65536
    repeatability: float = 0.002
    step: float = 0.0005

    def follow_commands(
        self, t: np.ndarray, speeds: np.ndarray, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """Simulate the joints under commands held from tick to tick.

        Parameters
        ----------
        t : (N,)
            Times of the commands [s].
        speeds : (N, J)
            Commanded velocities [rad/s].
        rng
            Draws the error of this performance.

        Returns
        -------
        times : (K,)
            Fine times [s].
        angles : (K, J)
            Angles turned since the start [rad].
        """
        fine = np.arange(t[0], t[-1] + self.step / 2, self.step)
        # a command acts from its very tick on, whatever the rounding
        command = np.searchsorted(t, fine + 1e-9, side="right") - 1
        held = speeds[np.clip(command, 0, len(t) - 1)]
        error = self.repeatability * rng.standard_normal(speeds.shape[1])
        velocity = held * (1 + error)

        # two equal poles p: -3 dB of 1 / (s / p + 1)^2 is at p sqrt(sqrt(2) - 1)
        pole_rate = -2 * np.pi * self.bandwidth / np.sqrt(np.sqrt(2) - 1)
        pole = np.exp(pole_rate * self.step)
        for _ in range(2):
            # y_k = (1 - p) x_k + p y_{k-1}; SciPy's filter takes half a second to load
            velocity = (1 - pole) * velocity
            for k in range(1, len(velocity)):
                velocity[k] += pole * velocity[k - 1]
        turned = np.zeros(velocity.shape)
        turned[1:] = np.cumsum(velocity[:-1], axis=0) * self.step
        return fine, turned

    def encoder_reading(self, angles: np.ndarray) -> np.ndarray:
        """Round angles of any shape [rad] to whole counts of the encoder."""
        return np.round(angles / self.resolution) * self.resolution
