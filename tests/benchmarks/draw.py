"""Draw a synthetic dataset whose causes are hidden, and write the ground truth apart.

Studies call `draw_dataset`; `python3 tasks.py study draw SEED FOLDER TRUTH` is `main`.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from tests.benchmarks.simulators import KINDS, SIMULATORS, draw
from tests.benchmarks.simulators.drawing import MIN_TRIALS


def draw_dataset(
    simulator: str,
    seed: int,
    folder: Path,
    truth_file: Path,
    kind: str | None = None,
    trials: int | None = None,
) -> None:
    """Write the synthetic dataset of a seed, and its ground truth apart.

    Parameters
    ----------
    simulator : its name, of `simulators.SIMULATORS`
    seed : from which string, casts and causes are drawn
    folder : for the measurements
    truth_file : JSON file for the ground truth
    kind : of `simulators.KINDS`, if not the seed's own
    trials : their number, if it is not drawn
    """
    dataset = draw(simulator, seed, kind, trials=trials)
    dataset.write(folder)
    dataset.write_truth(truth_file)


def main(arguments: Sequence[str]) -> int:
    """Run the command with its arguments and return the exit status."""
    parser = argparse.ArgumentParser("tasks.py study draw", description=__doc__)
    parser.add_argument("seed", type=int, help="of string, casts and causes")
    parser.add_argument("folder", type=Path, help="for the measurements")
    parser.add_argument("truth", type=Path, help="JSON file for the ground truth")
    parser.add_argument("--simulator", choices=SIMULATORS, default="own_kernel")
    parser.add_argument("--kind", choices=KINDS, help="if not the seed's own")
    parser.add_argument(
        "--trials",
        type=int,
        choices=range(MIN_TRIALS, 101),
        metavar="NUMBER",
        help=f"{MIN_TRIALS} to 100, if not drawn",
    )
    options = parser.parse_args(arguments)
    draw_dataset(
        options.simulator,
        options.seed,
        options.folder,
        options.truth,
        options.kind,
        options.trials,
    )
    print(f"The measurements are in {options.folder}, the truth in {options.truth}.")
    return 0
