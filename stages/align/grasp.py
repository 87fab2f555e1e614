"""Sightings of the grasp from measured points at the start of the string."""

from __future__ import annotations

import numpy as np

from stringcast.data.artifacts import JOINTS, Observation
from stringcast.data.schema import DataError
from stringcast.stages.align.sightings import SightedTrial, Sightings
from stringcast.stages.common import mad_sigma
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.hand import resample_joint_motion
from stringcast.stages.model.interpolation import interpolate_rows

MAX_GRASP_ARC_LENGTH_M = 1e-3  # points of smaller arc length are the grasp
# points nearer to the grasp of the joint angles were computed, not measured
MAX_COMPUTED_DISTANCE_M = 1e-5
MIN_SIGMA_M = 1e-4  # smallest estimate of the noise


def grasp_sightings(observation: Observation, arm: Arm) -> SightedTrial:
    """Return two sightings, in x and in y, for each point at the grasp of a trial.

    Raises DataError if the points do not show the grasp.
    """
    trial = f"trial {observation.trial}"
    if observation.arm is None:
        raise DataError(trial, "alignment needs joint angles", "Add arm.parquet.")
    points = observation.valid_points
    is_finite = np.isfinite(points[["x", "y"]]).all(axis=1)
    is_grasp = (points["s"] <= MAX_GRASP_ARC_LENGTH_M) & is_finite
    grasp = points[is_grasp].sort_values("t")
    if grasp.empty:
        raise DataError(
            trial,
            "no frames, and no point at the grasp (s = 0)",
            "Measure the start of the string, or add the frames.",
        )
    t, seen = grasp["t"].to_numpy(), grasp[["x", "y"]].to_numpy()
    log_t = observation.arm["t"].to_numpy()
    log = observation.arm[list(JOINTS)].to_numpy()
    reported = interpolate_rows(t, log_t, log)
    error = arm.joint_positions(reported)[:, -1] - seen
    if np.median(np.linalg.norm(error, axis=-1)) < MAX_COMPUTED_DISTANCE_M:
        raise DataError(
            trial,
            "the grasp in its points was computed from the joint angles, so it "
            "says nothing about the alignment",
            "Add the frames.",
        )

    if "sigma" in grasp:
        sigma = grasp["sigma"].to_numpy()
    else:
        # second differences remove the smooth part and multiply noise by sqrt(6)
        noise = MIN_SIGMA_M
        if len(error) > 2:
            noise = max(mad_sigma(np.diff(error, 2, axis=0)) / np.sqrt(6), MIN_SIGMA_M)
        sigma = np.full(len(grasp), noise)
    motion = resample_joint_motion(log_t, log).extended_until(t.max())
    sightings = hand_sightings(t, seen, sigma, len(JOINTS))
    return SightedTrial(observation.trial, motion, sightings)


def hand_sightings(
    t: np.ndarray, seen: np.ndarray, sigma: np.ndarray, links: int
) -> Sightings:
    """Return 2 K sightings of the hand, in x and in y.

    t: (K,) [s]. seen: positions (K, 2) [m]. sigma: of a coordinate (K,) [m]. links:
    number of the arm's links.
    """
    times, frame = np.unique(t, return_inverse=True)
    count = 2 * len(t)
    return Sightings(
        times,
        frame=np.repeat(frame, 2),
        link=np.full(count, links),
        share=np.ones(count),
        position=np.repeat(seen, 2, axis=0),
        direction=np.tile(np.eye(2), (len(t), 1)),
        sigma=np.repeat(sigma, 2),
    )
