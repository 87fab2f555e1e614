"""Experiments on measured trials, with a small camera."""

from pathlib import Path

from stringcast.pipeline.run.experiment import Experiment
from tests.experiments import compose_experiment

SMALL = (
    "camera.width=320",
    "camera.height=320",
    "camera.px_per_m=170.0",
    "camera.origin_px=[125.5,193.5]",
)


def about(trials: Path, *overrides: str) -> Experiment:
    """Compose an experiment on trials with overrides."""
    words = (*overrides, f"trials={trials}", "string.length=0.33", *SMALL)
    return compose_experiment(*words)
