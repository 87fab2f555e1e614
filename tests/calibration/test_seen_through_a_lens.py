"""A string filmed through a lens by a tilted camera.

It is read as accurately as without the lens, if the camera is known.
"""

from dataclasses import replace

import numpy as np
import pytest
from conftest import specimen, swing

from stringcast.data.artifacts import Film
from stringcast.hardware.virtual.bench import VirtualArm, VirtualBench, VirtualCamera
from stringcast.stages.diagnose.search.proposals import candidate_effects
from stringcast.stages.execute.execute import execute
from stringcast.stages.extract.extract import extract
from stringcast.stages.extract.footage import footage_from_joints
from stringcast.stages.model.camera import Camera
from stringcast.stages.model.lens import Lens
from stringcast.stages.model.library import effects_by_name
from stringcast.stages.model.model import Model

PLAIN_CAMERA = Camera(320, 320, 170.0, (125.5, 193.5), 50.0, exposure=0.001)
LENS = Lens((420.0, 422.0), (161.0, 158.0), (-0.2, 0.05, 0.001, -0.001))
LENS_CAMERA = replace(PLAIN_CAMERA, rotation=0.02, tilt=(0.04, -0.06), lens=LENS)
EXTRACTION_SETTINGS = {
    "string_length": 0.3,
    "points": 31,
    "sigmas": 6.0,
    "arm_width": 0.035,
    "hidden": 0.05,
    "shorter": 0.15,
    "longer": 0.2,
}


@pytest.fixture(scope="module")
def trial(arm):
    """Film a swing by the camera with a lens; return it with the true string."""
    bench = VirtualBench(arm, LENS_CAMERA, specimen("B"), seed=3)
    bench.look = replace(bench.look, string_width=0.008)
    made = execute(
        swing(), VirtualArm(bench), VirtualCamera(bench), before=0.1, after=0.1
    )
    return made, bench.string_at(made.frames["t"].to_numpy()), bench.specimen.length


def tip_errors(trial, arm, camera):
    """Return the distance of the tips read from the true ones, (F,) [m]."""
    made, true, length = trial
    film = Film(made.frames["t"].to_numpy(), made.images, arm=made.arm)
    readings = extract(
        footage_from_joints(film, arm),
        camera,
        **EXTRACTION_SETTINGS | {"string_length": length},
    ).readings
    good = readings["valid"].to_numpy(dtype=bool)
    assert good.mean() > 0.7
    return np.linalg.norm(
        readings[["tip_x", "tip_y"]].to_numpy()[good] - true[good, -1], axis=1
    )


def test_the_string_is_read_without_bias_only_with_the_lens(trial, arm):
    straight = replace(LENS_CAMERA, lens=replace(LENS, distortion=(0.0, 0.0, 0.0, 0.0)))
    known, ignored = (
        np.median(tip_errors(trial, arm, camera)) for camera in (LENS_CAMERA, straight)
    )
    assert known < 0.004  # a pixel is 6 mm; measured: 1.4 mm
    assert ignored > 0.008  # measured: 9.8 mm


def test_a_diagnosis_does_not_search_for_a_measured_lens(arm):
    string = specimen("B").string()
    names = {
        camera: {
            e.name
            for e in candidate_effects(
                Model(string, arm, camera), effects_by_name(), ()
            )
        }
        for camera in (PLAIN_CAMERA, LENS_CAMERA)
    }
    assert names[PLAIN_CAMERA] - names[LENS_CAMERA] == {"lens_distortion"}
