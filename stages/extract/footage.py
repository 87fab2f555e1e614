"""Input of extraction: frames, the pose of the grasp in each, and where the arm is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from stringcast.data.artifacts import JOINTS, Film
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.hand import resample_joint_motion
from stringcast.stages.model.model import Model


@dataclass(frozen=True)
class Footage:
    """Frames of one trial.

    t: (F,) times [s]. images: F uint8 arrays (height, width). grasp: (F, 3) pose of the
    grasp at those times. body: (F, J + 1, 2) the arm's joints [m], or None where no arm
    is in view.
    """

    t: np.ndarray
    images: Sequence[np.ndarray] = field(repr=False)
    grasp: np.ndarray
    body: np.ndarray | None = None


def footage_from_joints(film: Film, arm: Arm) -> Footage:
    """Grasp and arm as joint angles say; where only poses of the grasp were measured,
    no arm is known.
    """
    if film.arm is not None:
        angles = _interpolate_columns(film.t, film.arm, JOINTS)
        return Footage(
            film.t, film.images, arm.grasp_pose(angles), arm.joint_positions(angles)
        )
    assert film.grasp is not None
    grasp = film.grasp.assign(theta=np.unwrap(film.grasp["theta"]))
    return Footage(
        film.t, film.images, _interpolate_columns(film.t, grasp, ("x", "y", "theta"))
    )


def aligned_footage(film: Film, model: Model) -> Footage:
    """Grasp and arm where the camera reports them, if it was measured how camera and
    arm stand to each other.
    """
    if film.arm is None or not model.measured_ranges:
        return footage_from_joints(film, model.arm)
    motion = resample_joint_motion(
        film.arm["t"].to_numpy(), film.arm[list(JOINTS)].to_numpy()
    ).extended_until(film.t[-1])
    body = model.observed_arm(motion, model.values({})[None], film.t)[0]
    last = body[:, -1] - body[:, -2]
    direction = np.unwrap(np.arctan2(last[:, 1], last[:, 0]))
    return Footage(film.t, film.images, np.column_stack([body[:, -1], direction]), body)


def _interpolate_columns(
    t: np.ndarray, table: pd.DataFrame, columns: Sequence[str]
) -> np.ndarray:
    """Columns of a table at other times, (F, len(columns))."""
    return np.stack(
        [np.interp(t, table["t"], table[column]) for column in columns], axis=-1
    )
