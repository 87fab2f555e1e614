"""The arm as the camera reports it: rigid, so no string is simulated."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from stringcast.stages.model.arm import Arm
from stringcast.stages.model.hand import JointMotion
from stringcast.stages.model.model import Model


def arm_seen(model: Model, motion: JointMotion, values: np.ndarray, times: np.ndarray) -> np.ndarray:
    """The arm's joints as the camera reports them, base to hand, (1 or C, F, J + 1, 2) [m]. times: (F,) its clock's."""
    moments = np.atleast_2d(model.moments(values, times))
    return model.reported(joints_at(model.arm, model.joints(motion, values), moments), values, times)


def joints_at(arm: Arm, motion: JointMotion, moments: np.ndarray) -> np.ndarray:
    """Positions of base, joints and hand at moments (1 or C, M) of the arm's clock, at rest beyond its motion.

    Returns (C, M, J + 1, 2) [m]; C is 1 only if both are one for all.
    """
    ticks = motion.start + motion.tick * np.arange(motion.angles.shape[1])
    inside = np.clip(moments, ticks[0], ticks[-1])
    if len(motion.angles) == 1:
        return arm.joints(CubicHermiteSpline(ticks, motion.angles[0], motion.speeds[0])(inside))
    each = [
        CubicHermiteSpline(ticks, angles, speeds)(own)
        for angles, speeds, own in zip(
            motion.angles, motion.speeds, np.broadcast_to(inside, (len(motion.angles), inside.shape[1])), strict=True
        )
    ]
    return arm.joints(np.stack(each))
