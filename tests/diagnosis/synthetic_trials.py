"""Simulated trials with noise, and their diagnosis with few settings."""

import numpy as np
import pandas as pd
from conftest import TRUTH

from stringcast.data.artifacts import JOINTS, MASKS, READINGS, Observation
from stringcast.stages.diagnose.diagnose import diagnose
from stringcast.stages.diagnose.proposal.candidate_motions import DesignSettings
from stringcast.stages.diagnose.rules import Criteria
from stringcast.stages.diagnose.trials.discrepancy_model import attach_discrepancy_model
from stringcast.stages.estimate.matching import Matching
from stringcast.stages.generate.curves import Curves
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import fit_hypothesis
from stringcast.stages.model.hand import resample_joint_motion

SIGMA = 7e-4
SWING = np.array([[1.0, 0.6, -0.4, -1.0], [0.5, 0.9, 0.2, -0.8], [0.3] * 4])
CRITERIA = Criteria(
    max_causes=3,
    coverage=0.95,
    alpha=0.01,
    tip_tolerance_m=2e-3,
    min_explained_fraction=0.5,
)


def swing_angles(arm, count, seconds=0.5):
    """Yield joint angles of gentle swings of different sizes."""
    for k in range(count):
        control = np.zeros((1, 3, 6))
        control[0, :, 1:-1] = (1.5 + 0.5 * k) * SWING
        yield sample_curve(arm, control, seconds)


def sample_curve(arm, control, seconds):
    """Sample the joint angles of a curve with given control accelerations."""
    start = np.array([[0.3, 0.5, 0.2]])
    angles, *_ = Curves(start, np.array([seconds]), control).sample(arm.tick, seconds)
    return angles[0]


def simulate_trial(name, arm, model, values, angles, places, rng):
    """Simulate a trial with noisy points at some mass points.

    `angles` holds joint angles, one row a tick.
    """
    t = arm.tick * np.arange(len(angles))
    motion = resample_joint_motion(t, angles)
    strings = model.simulate_observation(motion, model.values(values)[None], t)
    clean = strings.points[0][:, places]
    return make_observation(name, model, t, angles, clean, places, rng)


def make_observation(name, model, t, angles, clean, places, rng, **fields):
    """Add noise to points (F, n, 2) [m], and combine them with the joint angles."""
    x, y = (clean + SIGMA * rng.standard_normal(clean.shape)).reshape(-1, 2).T
    count = clean.shape[1]
    s = np.tile(model.string.arc_lengths()[places], len(t))
    points = pd.DataFrame(
        {"t": np.repeat(t, count), "s": s, "x": x, "y": y, "sigma": SIGMA}
    )
    log = pd.DataFrame({"t": t} | dict(zip(JOINTS, angles.T, strict=True)))
    empty = (READINGS.empty(), MASKS.empty())
    return Observation(name, points, *empty, log, **fields)


def fit_base_model(model, trials):
    """Fit the base model to prepared trials from TRUTH, and return data and fit."""
    base = Hypothesis(model)
    chi = model.exponents_of_values(TRUTH)
    data = attach_discrepancy_model(trials, base, chi)
    no_discrepancy = np.zeros(len(trials), dtype=int)
    return data, fit_hypothesis(data, base, chi[None], no_discrepancy)


def diagnose_trials(model, observations, starts, held_out=(), motions=1, **settings):
    """Diagnose trials with the fewest allowed motions and rated frames."""
    design = DesignSettings(
        motions=motions, shortest=0.4, longest=0.8, alpha=150.0, before=0.05, after=0.1
    )
    matching = Matching(dilations=20, step_px=2, tip_step_px=3.0, delta_w=0.25)
    return diagnose(
        model,
        observations,
        {},
        held_out,
        (),
        seed=0,
        starts=starts,
        criteria=CRITERIA,
        matching=matching,
        design=design,
        **settings,
    )
