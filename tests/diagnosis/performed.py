"""Movements as they are observed, and what is said of them."""

import numpy as np
import pandas as pd

from stringcast.data.artifacts import JOINTS, MASKS, READINGS, Observation
from stringcast.stages.diagnose.casts import Design
from stringcast.stages.diagnose.diagnose import diagnose
from stringcast.stages.estimate.matching import Matching
from stringcast.stages.model.hand import joint_motion

SIGMA = 7e-4


def performed(name, arm, model, values, angles, places, rng):
    """A movement of the joints, one row a tick, with noisy points where mass points of these numbers are."""
    t = arm.tick * np.arange(len(angles))
    seen = model.seen(joint_motion(t, angles), model.values(values)[None], t).points[0][:, places]
    x, y = (seen + SIGMA * rng.standard_normal(seen.shape)).reshape(-1, 2).T
    s = np.tile(model.string.arc_lengths()[places], len(t))
    points = pd.DataFrame({"t": np.repeat(t, len(places)), "s": s, "x": x, "y": y, "sigma": SIGMA})
    log = pd.DataFrame({"t": t} | dict(zip(JOINTS, angles.T, strict=True)))
    return Observation(name, points, READINGS.empty(), MASKS.empty(), log)


def said_of(model, observations, starts, held_out=()):
    """The diagnosis, with no more of a design and of E than it must have."""
    design = Design(motions=1, shortest=0.4, longest=0.8, alpha=150.0, before=0.05, after=0.1)
    matching = Matching(dilations=20, step_px=2, tip_step_px=3.0, delta_w=0.25)
    return diagnose(model, observations, {}, held_out, (), seed=0, starts=starts, matching=matching, design=design)
