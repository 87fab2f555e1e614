"""The calibration experiment, from its settings to camera.yaml and the page.

Another experiment then uses its result.
"""

import io
import re

import cv2
import numpy as np
import pytest
import yaml
from omegaconf import OmegaConf
from studio import BOARD, SIZE, TILTED, picture, pose, tilted

from stringcast.data import store
from stringcast.data.calibration import Calibration
from stringcast.pipeline.cli.terminal import Terminal
from stringcast.pipeline.commands import board
from stringcast.pipeline.settings.composition import UserError, compose_settings
from stringcast.pipeline.settings.settings_from_runs import (
    inherit_settings,
    read_measured_camera,
)
from stringcast.pipeline.settings.typed_settings import build_dataclass
from stringcast.stages.calibrate.views import detect_board
from stringcast.stages.model.camera import Camera
from tests.experiments import compose_experiment

QUIET_TERMINAL = Terminal(quiet=True)


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Return pictures of the tilted board, and of the board in the plane of motion."""
    rng, top = np.random.default_rng(0), tmp_path_factory.mktemp("pictures")
    for name, pictures in {
        "tilted": tilted(rng),
        "flat": [picture(*pose(0.0, 0.0, 0.0, 0.0, 0.05, 0.42), rng)],
    }.items():
        (top / name).mkdir()
        for number, image in enumerate(pictures):
            cv2.imwrite(str(top / name / f"{number:02d}.png"), image)
    return top


def compose_calibration(folders, *more):
    given = {"source.folder": folders / "tilted", "plane.folder": folders / "flat"}
    given |= dict(override.split("=", 1) for override in more)
    words = [f"{name}={value}" for name, value in given.items()]
    return compose_experiment("+experiment=calibrate", "source=images", *words)


def test_other_experiments_can_use_the_calibrated_camera(folders, tmp_path):
    composed = compose_calibration(folders, "calibrate.place.corner=[0.1,0.2]")
    output_terminal = Terminal(file=io.StringIO(), width=1000)
    composed.mode.perform(composed, tmp_path, output_terminal)
    # stored images need no action by the user
    assert "Press Enter" not in output_terminal.file.getvalue()
    assert re.search(
        r"The camera is known: reprojection error 0\.\d+ px",
        output_terminal.file.getvalue(),
    )
    assert f"camera_from={tmp_path}" in output_terminal.file.getvalue()
    camera = build_dataclass(
        Camera, read_measured_camera(tmp_path), "camera", "camera.yaml"
    )
    assert (camera.width, camera.height) == SIZE
    corner = detect_board(
        0, cv2.imread(str(folders / "flat" / "00.png"), cv2.IMREAD_GRAYSCALE), BOARD
    )
    np.testing.assert_allclose(
        camera.world(corner.pixels),
        BOARD.corners[corner.corners] + [0.1, 0.2],
        atol=4e-4,
    )
    stored = store.load(Calibration, tmp_path / "calibration")
    assert stored.outcome["camera"].iloc[0] == (tmp_path / "camera.yaml").read_text()
    page = (tmp_path / "report.html").read_text()
    assert page.count("<img") == len(TILTED) + 2
    assert "camera.lens.focal[0]" in page
    assert not re.search(r'(src|href)="http', page)


def test_a_measured_camera_replaces_the_configured_one_except_on_the_command_line(
    tmp_path,
):
    measured = {
        "width": 320,
        "height": 240,
        "px_per_m": 512.5,
        "origin_px": [1.5, 2.5],
        "fps": 50.0,
        "rotation": 0.01,
    }
    (tmp_path / "camera.yaml").write_text(yaml.safe_dump(measured))
    config = OmegaConf.create(
        compose_settings([f"camera_from={tmp_path}", "camera.fps=60"])
    )
    assert inherit_settings(config, {"camera_from", "camera.fps"})[
        "camera"
    ] == measured | {"fps": 60}
    assert (
        inherit_settings(OmegaConf.create(compose_settings()), set())["camera"]["width"]
        == 640
    )


def test_a_bad_calibration_is_refused_and_its_page_has_the_reason(
    folders, tmp_path, undrawn
):
    composed = compose_calibration(folders, "calibrate.views=20")
    with pytest.raises(
        UserError,
        match=r"12 views can be used, 20 are needed\. Take more\. See .*report\.html",
    ):
        composed.mode.perform(composed, tmp_path, QUIET_TERMINAL)
    assert not (tmp_path / "camera.yaml").exists()
    assert (
        "No <code>camera.yaml</code> was written"
        in (tmp_path / "report.html").read_text()
    )
    with pytest.raises(
        UserError,
        match=r"camera\.yaml: there is no such file.* Name the run folder of a good calibration",
    ):
        read_measured_camera(tmp_path)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ("source.folder=null", r"source\.folder = None"),
        ("board.marker=0.03", "smaller than the square"),
    ],
)
def test_wrong_settings_are_refused_by_name(folders, tmp_path, wrong, words):
    composed = compose_calibration(folders, wrong)
    with pytest.raises(UserError, match=words):
        composed.mode.perform(composed, tmp_path, QUIET_TERMINAL)


def test_the_board_is_drawn_in_its_true_size(tmp_path):
    assert board.main([str(tmp_path / "board.pdf")]) == 0
    content = (tmp_path / "board.pdf").read_bytes()
    box = re.search(rb"/MediaBox \[ ?0 0 ([\d.]+) ([\d.]+)", content)
    width, height = (float(side) / 72 * 0.0254 for side in box.groups())
    assert width == pytest.approx(8 * 0.024 + 0.016, abs=1e-5)
    assert height < 0.297  # the board fits on A4
    assert (
        detect_board(
            0,
            cv2.copyMakeBorder(
                BOARD.image(40), 30, 30, 30, 30, cv2.BORDER_CONSTANT, value=255
            ),
            BOARD,
        ).reason
        == ""
    )
