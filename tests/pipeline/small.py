"""Experiments about trials of others, with a small camera."""

from pathlib import Path

from omegaconf import OmegaConf

from stringcast.pipeline.experiment import Experiment, prepare
from stringcast.pipeline.settings import composed

SMALL = ("camera.width=320", "camera.height=320", "camera.px_per_m=170.0", "camera.origin_px=[125.5,193.5]")


def about(trials: Path, *overrides: str) -> Experiment:
    """An experiment ready to be performed. overrides: as on the command line."""
    asked = OmegaConf.create(composed([*overrides, f"trials={trials}", "string.length=0.33", *SMALL]))
    return prepare(OmegaConf.to_container(asked, resolve=True), lambda block: f"conf/{block}")
