"""Movements as they are observed, and what is said of them."""

import numpy as np
import pandas as pd

from stringcast.data.artifacts import JOINTS, MASKS, READINGS, Observation
from stringcast.stages.diagnose.candidate_motions import DesignSettings
from stringcast.stages.diagnose.diagnose import diagnose
from stringcast.stages.diagnose.rules import Criteria
from stringcast.stages.estimate.matching import Matching
from stringcast.stages.generate.curves import Curves
from stringcast.stages.model.hand import resample_joint_motion

SIGMA = 7e-4
CRITERIA = Criteria(
    max_causes=3,
    coverage=0.95,
    alpha=0.01,
    tip_tolerance_m=2e-3,
    min_tip_shift_m=5e-4,
    min_explained_fraction=0.5,
    min_explained_fraction_if_misfit=0.9,
)


def swings(arm, count, seconds=0.5):
    """Gentle swings there and back, each of another size."""
    for k in range(count):
        control = np.zeros((1, 3, 6))
        control[0, :, 1:-1] = (1.5 + 0.5 * k) * np.array(
            [[1.0, 0.6, -0.4, -1.0], [0.5, 0.9, 0.2, -0.8], [0.3] * 4]
        )
        yield Curves(np.array([[0.3, 0.5, 0.2]]), np.array([seconds]), control).sample(
            arm.tick, seconds
        )[0][0]


def performed(name, arm, model, values, angles, places, rng):
    """A movement of the joints, one row a tick, with noisy points where mass points of
    these numbers are.
    """
    t = arm.tick * np.arange(len(angles))
    seen = model.simulate_observation(
        resample_joint_motion(t, angles), model.values(values)[None], t
    ).points[0][:, places]
    x, y = (seen + SIGMA * rng.standard_normal(seen.shape)).reshape(-1, 2).T
    s = np.tile(model.string.arc_lengths()[places], len(t))
    points = pd.DataFrame(
        {"t": np.repeat(t, len(places)), "s": s, "x": x, "y": y, "sigma": SIGMA}
    )
    log = pd.DataFrame({"t": t} | dict(zip(JOINTS, angles.T, strict=True)))
    return Observation(name, points, READINGS.empty(), MASKS.empty(), log)


def said_of(model, observations, starts, held_out=()):
    """The diagnosis, with no more of a design and of E than it must have."""
    design = DesignSettings(
        motions=1, shortest=0.4, longest=0.8, alpha=150.0, before=0.05, after=0.1
    )
    matching = Matching(dilations=20, step_px=2, tip_step_px=3.0, delta_w=0.25)
    settings = {
        "starts": starts,
        "criteria": CRITERIA,
        "matching": matching,
        "design": design,
    }
    return diagnose(model, observations, {}, held_out, (), seed=0, **settings)
