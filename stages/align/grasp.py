"""The grasp as measured points show it: the string's beginning, which is rigid with the
last link.
"""

from __future__ import annotations

import numpy as np

from stringcast.data.artifacts import JOINTS, Observation
from stringcast.data.schema import DataError
from stringcast.stages.align.sightings import SightedTrial, Sightings
from stringcast.stages.common import mad_sigma
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.hand import resample_joint_motion

# [m] of arc length: a point as near to the grasp as that is the grasp
MATCH_TOLERANCE_M = 1e-3
# [m] a point nearer than that to where the joints have it was not measured
MAX_MEASURED_MISMATCH_M = 1e-5
MIN_SIGMA_M = 1e-4  # [m] a standard deviation that is not given is not less


def grasp_sightings(observation: Observation, arm: Arm) -> SightedTrial:
    """The grasp as a trial's points have it, each in x and in y. Raises DataError where
    they do not show it.
    """
    if observation.arm is None:
        raise DataError(
            f"trial {observation.trial}: alignment needs joint angles. Add arm.parquet."
        )
    points = observation.valid_points
    grasp = points[
        (points["s"] <= MATCH_TOLERANCE_M) & np.isfinite(points[["x", "y"]]).all(axis=1)
    ].sort_values("t")
    if grasp.empty:
        raise DataError(
            f"trial {observation.trial}: no frames, and no point at the grasp (s = 0). Measure the string's beginning, "
            "or add the frames."
        )
    t, seen = grasp["t"].to_numpy(), grasp[["x", "y"]].to_numpy()
    reported = np.stack(
        [np.interp(t, observation.arm["t"], observation.arm[q]) for q in JOINTS],
        axis=-1,
    )
    off = arm.joint_positions(reported)[:, -1] - seen
    if np.median(np.linalg.norm(off, axis=-1)) < MAX_MEASURED_MISMATCH_M:
        raise DataError(
            f"trial {observation.trial}: its points begin where the joints say that the grasp is, which "
            "shows nothing. Add the frames."
        )
    # of what goes on evenly from frame to frame but for noise
    jumps = np.diff(off, 2, axis=0)
    noise = (
        max(float(mad_sigma(jumps)) / np.sqrt(6), MIN_SIGMA_M)
        if len(jumps)
        else MIN_SIGMA_M
    )
    sigma = (
        grasp["sigma"].to_numpy() if "sigma" in grasp else np.full(len(grasp), noise)
    )
    motion = resample_joint_motion(
        observation.arm["t"].to_numpy(), observation.arm[list(JOINTS)].to_numpy()
    ).extended_until(t.max())
    return SightedTrial(
        observation.trial, motion, hand_sightings(t, seen, sigma, len(JOINTS))
    )


def hand_sightings(
    t: np.ndarray, seen: np.ndarray, sigma: np.ndarray, links: int
) -> Sightings:
    """Sightings of the hand in both directions. t: (K,) [s]. seen: (K, 2) [m]. sigma:
    (K,) [m].
    """
    times, frame = np.unique(t, return_inverse=True)
    count = 2 * len(t)
    along = np.tile(np.eye(2), (len(t), 1))
    where = (
        np.repeat(frame, 2),
        np.full(count, links),
        np.ones(count),
        np.repeat(seen, 2, axis=0),
    )
    return Sightings(times, *where, along, np.repeat(sigma, 2))
