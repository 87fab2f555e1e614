"""A few trials of a bench, and experiments about them with a small camera."""

import pytest
from omegaconf import OmegaConf

from stringcast.hardware.virtual.blind import VERSIONS, draw
from stringcast.pipeline.experiment import Experiment, prepare
from stringcast.pipeline.settings import composed

SMALL = ("camera.width=320", "camera.height=320", "camera.px_per_m=170.0", "camera.origin_px=[125.5,193.5]")


@pytest.fixture(scope="module")
def data(arm, camera, tmp_path_factory):
    """A folder of trials that hide nothing."""
    folder = tmp_path_factory.mktemp("theirs")
    draw(VERSIONS[1].cases.index("none"), arm, camera, 1).write(folder)
    return folder


def about(data, *overrides) -> Experiment:
    """An experiment ready to be performed. overrides: as on the command line."""
    asked = OmegaConf.create(composed([*overrides, f"trials={data}", "string.length=0.33", *SMALL]))
    return prepare(OmegaConf.to_container(asked, resolve=True), lambda block: f"conf/{block}")
