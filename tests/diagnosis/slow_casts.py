"""Two slow casts of string B by the own kernel: a dataset for fast diagnoses."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import yaml

from stringcast.stages.model.arm import Arm
from stringcast.stages.model.camera import Camera
from tests.benchmarks.simulators import (
    GroundTruth,
    SyntheticDataset,
    load_simulator,
)
from tests.benchmarks.simulators.motions import random_cast
from tests.benchmarks.simulators.rod import Rod
from tests.benchmarks.simulators.scene import Fidelity, Scene

ROOT = Path(__file__).resolve().parents[2]
SEED = 41
SIGMA_M = 7e-4
HAND_SPEED_M_S = 1.2


def write_slow_casts(
    folder: Path,
    arm: Arm,
    camera: Camera,
    settings: Mapping[str, float],
    only_cast: int | None = None,
) -> None:
    """Write a dataset of two slow casts with hidden causes.

    Parameters
    ----------
    folder : of the dataset
    arm, camera : of the lab
    settings : of the hidden causes, by name
    only_cast : number of the only cast in which they act, None for both
    """
    rng = np.random.default_rng(SEED)
    string = yaml.safe_load((ROOT / "conf/specimen/B.yaml").read_text())
    length = string["length"]
    casts = []
    for _ in range(2):
        casts.append(random_cast(arm, rng, camera.fps, HAND_SPEED_M_S))
    rod = Rod.from_paper_parameters(length, **string["parameters"])
    s = np.linspace(0.1, 1.0, 8) * length
    simulator = load_simulator("own_kernel")
    scene = Scene(simulator, arm, camera, rod, tuple(casts), s, SIGMA_M)
    points = []
    for number, cast in enumerate(casts):
        active = settings if only_cast in (None, number) else {}
        clean = scene.observe(cast, active, Fidelity.FINAL)
        points.append(clean + SIGMA_M * rng.standard_normal(clean.shape))
    truth = GroundTruth("own_kernel", SEED, "", (), {}, SIGMA_M, {}, (), 0, 0.0)
    SyntheticDataset(scene, tuple(points), True, truth).write(folder)
