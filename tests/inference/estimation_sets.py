"""Random sets of casts from which a string's eight parameters are estimated.

A set has four casts of a second and one that is held out. Even seeds are the virtual
lab's strings A to D in turn. Odd ones are drawn by `draw_cast_set` from the whole of
the paper's ranges (Table 3), limp and stiff, with next to no drag and with much.
Measured places are the mass points of the fitted chain, with noise. Seeds below
FIRST_FINER_SEED come from a chain like the one that is fitted, so that only noise
separates a fit from the truth. Those above come from a finer one, whose difference no
fit can explain.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pandas as pd
import yaml

from stringcast.data.artifacts import JOINTS, Observation
from stringcast.stages.generate.curves import Curves, first_curves
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.camera import Camera
from stringcast.stages.model.engine.implicit_leapfrog import ImplicitLeapfrog
from stringcast.stages.model.engine.sampling import interpolate_along_string
from stringcast.stages.model.hand import resample_joint_motion
from stringcast.stages.model.model import Model
from stringcast.stages.model.string import String
from tests.benchmarks.speed.cord import ROOT
from tests.observations import observe_points

CASTS = 4
DURATION = (0.5, 0.8)  # duration of the movement [s]; the string swings on until END
END = 1.0  # [s]
# range of the hand's greatest speed [m/s]
SPEEDS = (2.0, 10.0)
ALPHA = 150.0  # [rad/s2], as in conf/generate/bezier.yaml
FRAME_TIMES = np.arange(201) / 200  # [s], at the rate of conf/camera/highspeed.yaml
NOISE = 7e-4  # [m], noise of a point that the extract stage reads
PLACES = np.linspace(0.3 / 19, 0.3, 19)  # [m] of arc length
FIRST_FINER_SEED = 24
FITTED, FINER, FINEST = (20, 1e-3), (28, 5e-4), (57, 5e-4)  # points and step [s]
# largest change [m] of the tip by FINER; no mesh resolves a more chaotic cast
MAX_MESH_ERROR_M = 0.02
LAB_STRINGS = ("A", "B", "C", "D")


@dataclass(frozen=True)
class CastSet:
    """Trials with noise and one held out without, of a string with parameters (P,)."""

    name: str
    truth: np.ndarray
    trials: tuple[Observation, ...]
    held_out: Observation


@cache
def model(points: int = FITTED[0], step: float = FITTED[1]) -> Model:
    """Return the model that is fitted: string=coarse with the paper's arm."""
    arm, camera = (
        Arm(**read_block("arm/paper.yaml")),
        Camera(**read_block("camera/highspeed.yaml")),
    )
    second_order = {
        "tip_cell": 0.5,
        "grasp_cell": 0.5,
        "integrator": ImplicitLeapfrog(),
        "largest_step": step,
    }
    return Model(String(0.3, points=points, **second_order), arm, camera)


def read_block(path: str) -> dict:  # type: ignore[type-arg]
    """Return a block of conf/ with lists as tuples."""
    block = yaml.safe_load((ROOT / "conf" / path).read_text())
    return {
        k: tuple(v) if isinstance(v, list) else v
        for k, v in block.items()
        if k != "_target_"
    }


def draw_cast_set(seed: int) -> CastSet:
    """Draw the set of a seed."""
    rng = np.random.default_rng([seed, 32])
    name = (
        LAB_STRINGS[seed // 2 % len(LAB_STRINGS)] if seed % 2 == 0 else f"random {seed}"
    )
    string = model().string
    truth = np.array([p.value(rng.uniform()) for p in string.parameters])
    if name in LAB_STRINGS:
        truth = string.values(read_block(f"specimen/{name}.yaml")["parameters"])
    chain = model(*FITTED) if seed < FIRST_FINER_SEED else model(*FINEST)
    casts = [_draw_regular_cast(truth, rng) for _ in range(CASTS + 1)]
    seen = [
        observe_cast(f"t{k}", chain, truth, log, rng, NOISE * (k < CASTS))
        for k, log in enumerate(casts)
    ]
    return CastSet(name, truth, tuple(seen[:CASTS]), seen[CASTS])


def _draw_regular_cast(truth: np.ndarray, rng: np.random.Generator) -> pd.DataFrame:
    """Return the joint log of the first of random casts that is not chaotic."""
    arm = model().arm
    while True:
        log = _joint_log(arm, _draw_movement(arm, rng))
        rough, finer = (
            _simulate(model(*chain), truth, log) for chain in (FITTED, FINER)
        )
        if (
            np.linalg.norm(rough[:, -1] - finer[:, -1], axis=-1).max()
            < MAX_MESH_ERROR_M
        ):
            return log


def _joint_log(arm: Arm, curves: Curves) -> pd.DataFrame:
    """Return what the arm reports of a movement and of the rest after it."""
    angles, _ = curves.sample(arm.tick, END)
    return pd.DataFrame(
        {"t": arm.tick * np.arange(angles.shape[1])}
        | dict(zip(JOINTS, angles[0].T, strict=True))
    )


def _draw_movement(arm: Arm, rng: np.random.Generator) -> Curves:
    """Draw movements until the arm can do one and its hand is fast enough."""
    while True:
        curves = first_curves(arm, rng, 1, DURATION, ALPHA * rng.uniform())
        angles, speeds = curves.sample(arm.tick, END)
        hand = np.linalg.norm(
            arm.grasp_velocity(angles, speeds)[..., :2], axis=-1
        ).max()
        inside = (angles > arm.lowest).all() and (angles < arm.highest).all()
        if inside and SPEEDS[0] <= hand <= SPEEDS[1]:
            return curves


def _simulate(chain: Model, truth: np.ndarray, log: pd.DataFrame) -> np.ndarray:
    """Simulate the string in each frame, (F, n, 2) [m]."""
    motion = resample_joint_motion(log["t"].to_numpy(), log[list(JOINTS)].to_numpy())
    return chain.simulate_string(motion, truth[None], FRAME_TIMES).points[0]


def observe_cast(
    name: str,
    chain: Model,
    truth: np.ndarray,
    log: pd.DataFrame,
    rng: np.random.Generator,
    noise: float,
) -> Observation:
    """Observe a cast at PLACES in each frame, with noise [m]."""
    points = _simulate(chain, truth, log)
    place = PLACES / chain.string.segment_length
    line = interpolate_along_string(points[None], place[None])[0]
    seen = line + noise * rng.standard_normal(line.shape)
    return observe_points(name, FRAME_TIMES, PLACES, seen, NOISE, arm=log)
