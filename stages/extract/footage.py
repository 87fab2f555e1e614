"""Input of extraction: frames, with the pose of the grasp and the arm's joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd

from stringcast.data.artifacts import JOINTS, Film
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.hand import resample_joint_motion
from stringcast.stages.model.interpolation import interpolate_rows
from stringcast.stages.model.model import Model


@dataclass(frozen=True)
class Footage:
    """Frames of one trial with the arm in each.

    Parameters
    ----------
    t : (F,) times [s]
    images : F uint8 arrays (height, width)
    grasp : (F, 3) pose of the grasp, x and y [m] and theta [rad]
    body : (F, J + 1, 2) joints of the arm [m]; None where no arm is in view
    """

    t: np.ndarray
    images: Sequence[np.ndarray] = field(repr=False)
    grasp: np.ndarray
    body: np.ndarray | None = None

    def with_body(self, body: np.ndarray) -> Footage:
        """Place the arm (F, J + 1, 2) [m], and the grasp at its hand."""
        return replace(self, body=body, grasp=pose_of_hand(body))


def footage_from_joints(film: Film, arm: Arm) -> Footage:
    """Compute grasp and arm from joint angles, or the grasp from its measured poses."""
    if film.arm is not None:
        angles = _table_rows_at(film.t, film.arm, JOINTS)
        grasp = arm.grasp_pose(angles)
        return Footage(film.t, film.images, grasp, arm.joint_positions(angles))
    assert film.grasp is not None
    poses = film.grasp.assign(theta=np.unwrap(film.grasp["theta"]))
    grasp = _table_rows_at(film.t, poses, ("x", "y", "theta"))
    return Footage(film.t, film.images, grasp)


def aligned_footage(film: Film, model: Model) -> Footage:
    """Compute grasp and arm as the camera reports them, with a measured alignment."""
    if film.arm is None or not model.measured_ranges:
        return footage_from_joints(film, model.arm)
    motion = resample_joint_motion(
        film.arm["t"].to_numpy(), film.arm[list(JOINTS)].to_numpy()
    )
    motion = motion.extended_until(film.t[-1])
    body = model.observed_arm(motion, model.values({})[None], film.t)[0]
    return Footage(film.t, film.images, pose_of_hand(body), body)


def pose_of_hand(body: np.ndarray) -> np.ndarray:
    """Compute the pose of the hand (F, 3) [m], [rad] from joints (F, J + 1, 2) [m]."""
    hand = body[:, -1]
    link = hand - body[:, -2]
    direction = np.unwrap(np.arctan2(link[:, 1], link[:, 0]))
    return np.column_stack([hand, direction])


def _table_rows_at(
    t: np.ndarray, table: pd.DataFrame, columns: Sequence[str]
) -> np.ndarray:
    """Interpolate columns of a table at times t (F,) [s], (F, len(columns))."""
    rows = table[list(columns)].to_numpy()
    return interpolate_rows(t, table["t"].to_numpy(), rows)
