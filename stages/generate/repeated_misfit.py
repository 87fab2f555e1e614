"""The misfit of the last cast, which a similar motion repeats.

An effect missing in the model moves the tip similarly on similar motions. The misfit is
therefore a Gaussian process over the path of the hand (Kennedy and O'Hagan, J. R. Stat.
Soc. B 63, 425, 2001), known on the last cast. A similar motion is corrected by this
misfit. On a distant motion the misfit counts as uncertainty. Iterative learning control
repeats a motion for the same reason.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stringcast.data.artifacts import Motion
from stringcast.data.estimates import Estimate
from stringcast.stages.generate.curves import Curves, curves_from_motion
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.interpolation import interpolate_rows

# root mean square distance of two hand paths, as a share of the string's length, at
# which misfits of the tip have a correlation of 0.6; measured, see README.md
SIMILARITY_SHARE = 1 / 3


@dataclass(frozen=True)
class RepeatedMisfit:
    """The misfit of the tip on the last cast.

    Parameters
    ----------
    arm : the arm
    last : the motion of the last cast
    times : (T,) [s]
    tip : (T, 2) measured less simulated tip at these times [m]
    similarity : distance of two hand paths at which misfits have a correlation of 0.6
        [m]
    """

    arm: Arm
    last: Curves
    times: np.ndarray
    tip: np.ndarray
    similarity: float

    def without_mesh_error(self, estimate: Estimate) -> RepeatedMisfit:
        """Remove the error of the mesh in the last cast, as the estimate states it."""
        subtracted = estimate.misfit[["mesh_x", "mesh_y"]].to_numpy()
        return replace(self, tip=self.tip + subtracted)

    def correlation(self, curves: Curves, until: float) -> np.ndarray:
        """Compute the correlation of M motions' misfits with the last, (M, K) at ticks.

        At each tick, only the hand paths until then count.

        Parameters
        ----------
        curves : Curves
            M motions.
        until : float
            The last tick [s].
        """
        squares = (hand_paths(self.arm, curves, until) - self.hand_path(until)) ** 2
        total = np.cumsum(squares.sum(axis=-1), axis=1)
        mean = total / np.arange(1, total.shape[1] + 1)
        return np.exp(-0.5 * mean / self.similarity**2)

    def hand_path(self, until: float) -> np.ndarray:
        """Return the planned path of the hand in the last cast at ticks, (K, 2) [m]."""
        return hand_paths(self.arm, self.last, until)[0]

    def tip_at_ticks(self, count: int) -> np.ndarray:
        """Interpolate the misfit of the last cast at ticks, (K, 2) [m]."""
        ticks = self.arm.tick * np.arange(count)
        return interpolate_rows(ticks, self.times, self.tip)

    def sigma_at_ticks(self, count: int) -> np.ndarray:
        """Return the largest misfit until each tick, as a coordinate's sigma, (K,) [m].

        The residual of an estimate is averaged over all trials and points, also those
        near the hand, which hardly move. The error of the tip may be larger.
        """
        sizes = np.hypot(*self.tip_at_ticks(count).T)
        return np.maximum.accumulate(sizes) / np.sqrt(2)


def hand_paths(arm: Arm, curves: Curves, until: float) -> np.ndarray:
    """Return the paths of the hand on M motions at ticks, (M, K, 2) [m]."""
    angles, _ = curves.sample(arm.tick, until)
    return arm.joint_positions(angles)[:, :, -1]


def find_repeated_misfit(
    arm: Arm, length: float, previous: Motion | None, estimate: Estimate | None
) -> RepeatedMisfit | None:
    """Find the misfit that a motion like the previous one would repeat.

    Parameters
    ----------
    arm : Arm
        The arm.
    length : float
        Length of the string [m].
    previous : Motion or None
        The last motion.
    estimate : Estimate or None
        The latest estimate.

    Returns
    -------
    RepeatedMisfit or None
        None if there was no cast yet (a look is too slow to compare), or if the last
        trial of the estimate is not the previous motion.
    """
    if previous is None or not previous.is_cast:
        return None
    if estimate is None or estimate.misfit.empty:
        return None
    table = estimate.misfit
    times = table["t"].to_numpy()
    last = curves_from_motion(previous)
    similarity = SIMILARITY_SHARE * length
    tip = table[["x", "y"]].to_numpy()
    misfit = RepeatedMisfit(arm, last, times, tip, similarity)
    planned = misfit.hand_path(previous.duration)
    ticks = arm.tick * np.arange(len(planned))
    performed = [np.interp(ticks, times, table[name]) for name in ("hand_x", "hand_y")]
    distance = np.sqrt(np.mean(np.sum((np.stack(performed, 1) - planned) ** 2, axis=1)))
    return misfit if distance <= similarity else None
