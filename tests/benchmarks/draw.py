"""Draw a synthetic dataset whose cause of misfit is hidden, and write the ground truth
apart from it.

`draw_dataset` is what studies call; `main` is the command `python3 tasks.py study draw
SEED FOLDER TRUTH`.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from stringcast.pipeline.settings.composition import compose_settings
from stringcast.pipeline.settings.typed_settings import build_dataclass
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.camera import Camera
from tests.benchmarks.simulators import laboratory
from tests.benchmarks.simulators.blind import draw


def draw_dataset(
    simulator: str, seed: int, folder: Path, truth_file: Path, kind: str | None = None
) -> None:
    """Write the synthetic dataset of a seed into a folder, and its ground truth into a
    file.
    """
    if simulator == "own_kernel":
        blocks = compose_settings()
        arm = build_dataclass(Arm, blocks["arm"], "arm", "conf/arm")
        camera = build_dataclass(Camera, blocks["camera"], "camera", "conf/camera")
        bench = draw(seed, arm, camera)
    else:
        bench = laboratory.drawn(simulator, seed, kind)
    bench.write(folder)
    bench.envelope(truth_file)


def main(arguments: Sequence[str]) -> int:
    """Run the command with its arguments and return the exit status."""
    parser = argparse.ArgumentParser(
        "tasks.py study draw", description=__doc__.splitlines()[0]
    )
    parser.add_argument(
        "seed", type=int, help="from which string, casts and cause are drawn"
    )
    parser.add_argument("folder", type=Path, help="for the measured data")
    parser.add_argument("truth", type=Path, help="JSON file for the hidden cause")
    simulators = ("own_kernel", "nodal", "pyelastica")
    parser.add_argument("--simulator", choices=simulators, default="own_kernel")
    options = parser.parse_args(arguments)
    draw_dataset(options.simulator, options.seed, options.folder, options.truth)
    print(
        f"The measurements are in {options.folder}, the hidden cause in {options.truth}."
    )
    return 0
