"""The arm as the camera reports it: rigid, so no string is simulated."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from stringcast.stages.model.hand import JointMotion
from stringcast.stages.model.model import Model


def arm_seen(model: Model, motion: JointMotion, values: np.ndarray, times: np.ndarray) -> np.ndarray:
    """The arm's joints as the camera reports them, base to hand, (1 or C, F, J + 1, 2) [m]; at rest beyond its motion.
    times: (F,) of the camera's clock."""
    moments, real = np.atleast_2d(model.moments(values, times)), model.joints(motion, values)
    ticks = real.start + real.tick * np.arange(real.angles.shape[1])
    inside = np.clip(moments, ticks[0], ticks[-1])
    if len(real.angles) == 1:
        angles = CubicHermiteSpline(ticks, real.angles[0], real.speeds[0])(inside)
    else:
        asked = np.broadcast_to(inside, (len(real.angles), inside.shape[1]))
        each = zip(real.angles, real.speeds, asked, strict=True)
        angles = np.stack([CubicHermiteSpline(ticks, place, speed)(own) for place, speed, own in each])
    return model.reported(model.arm.joints(angles), values, times)
