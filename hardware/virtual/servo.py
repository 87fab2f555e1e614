"""The velocity loop of an arm, with delay and errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class VirtualServo:
    """The velocity loop of each joint, and its encoder.

    Attributes
    ----------
    bandwidth
        -3 dB frequency of the loop [Hz].
    resolution
        One count of the encoder [rad].
    repeatability
        Relative error of the speed between performances, one sigma.
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
        """Simulate the joints under commands that are held for a tick.

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
        times = np.arange(t[0], t[-1] + self.step / 2, self.step)
        # robust to rounding: a command acts from its tick on
        command = np.searchsorted(t, times + 1e-9, side="right") - 1
        held = speeds[np.clip(command, 0, len(t) - 1)]  # (K, J)
        error = self.repeatability * rng.standard_normal(speeds.shape[1])
        velocity = self._low_pass(self._low_pass(held * (1 + error)))

        angles = np.zeros(velocity.shape)
        angles[1:] = np.cumsum(velocity[:-1], axis=0) * self.step
        return times, angles

    def _low_pass(self, signal: np.ndarray) -> np.ndarray:
        """Filter a signal (K, J) by one of the loop's two equal poles.

        The loop is 1 / (s / p + 1)^2, with -3 dB at the angular frequency p
        sqrt(sqrt(2) - 1). In steps h, each pole a = exp(-p h) gives

            y_k = (1 - a) x_k + a y_{k-1}.
        """
        corner = 2 * np.pi * self.bandwidth / np.sqrt(np.sqrt(2) - 1)  # p [rad/s]
        pole = np.exp(-corner * self.step)
        filtered = (1 - pole) * signal
        # in Python, as loading SciPy's filter takes half a second
        for k in range(1, len(filtered)):
            filtered[k] += pole * filtered[k - 1]
        return filtered

    def encoder_reading(self, angles: np.ndarray) -> np.ndarray:
        """Round angles [rad] to whole counts of the encoder."""
        return np.round(angles / self.resolution) * self.resolution
