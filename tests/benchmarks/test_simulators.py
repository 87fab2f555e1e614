"""Parts of the reference simulators: hand, clocks, camera, motions and registry."""

import sys

import numpy as np
import pytest

from stringcast.data.schema import DataError
from stringcast.stages.model.library import effects_by_name
from tests.benchmarks.simulators import load_simulator
from tests.benchmarks.simulators.camera_faults import CameraFaults, report_points
from tests.benchmarks.simulators.causes import LIBRARY_CAUSES, OUTSIDE_CAUSES
from tests.benchmarks.simulators.hand import (
    HandFaults,
    actual_joint_angles,
    slip_distance,
)
from tests.benchmarks.simulators.motions import random_cast
from tests.benchmarks.simulators.own_kernel_effects import OUTSIDE_EFFECTS
from tests.benchmarks.simulators.rod import Rod
from tests.conftest import TRUTH

T = np.arange(0, 1, 0.001)
RAMP = 2.0 * T[:, None] * np.ones(3)


def test_a_lagging_joint_follows_a_ramp_late_by_its_time_constant():
    lagging = actual_joint_angles(T, RAMP, HandFaults(lag=0.03))
    late = 2.0 * (T - 0.03 * (1 - np.exp(-T / 0.03)))
    assert lagging == pytest.approx(late[:, None] * np.ones(3), abs=1e-9)


def test_a_hand_without_faults_does_what_it_is_told():
    assert actual_joint_angles(T, RAMP, HandFaults()) == pytest.approx(RAMP)


def test_a_slip_is_as_long_as_its_speed_and_duration_say():
    slip = slip_distance(T, HandFaults(slip=0.1, slip_from=0.2, slip_until=0.5))
    assert slip[-1] == pytest.approx(0.03)


def falling(times):
    return np.stack([0.5 + 0 * times, 0.6 - 2.0 * times], axis=-1)[:, None, :]


def reported(camera, **faults):
    return report_points(falling, FRAMES, camera, CameraFaults(**faults))


FRAMES = np.linspace(0.1, 0.2, 5)


def test_clock_and_scale_faults_have_their_sign(camera):
    plain = reported(camera)
    assert plain == pytest.approx(falling(FRAMES), abs=1e-12)
    late = falling(FRAMES + 0.01)
    assert reported(camera, offset=0.01) == pytest.approx(late, abs=1e-12)
    fast = falling(1.1 * FRAMES)
    assert reported(camera, drift=0.1) == pytest.approx(fast, abs=1e-12)
    assert reported(camera, scale=0.02) == pytest.approx(1.02 * plain, abs=1e-12)


def test_a_rolling_shutter_sees_a_point_when_its_row_is_exposed(camera):
    points = reported(camera, readout=0.01)
    row = camera.pixels(points)[..., 1] / camera.height - 0.5
    exposed = falling(FRAMES + 0.01 * row[:, 0])
    assert points[:, 0] == pytest.approx(exposed[:, 0], abs=1e-6)


def test_the_papers_parameters_are_the_rods():
    base = TRUTH | {"bending_stiffness": 5.0}
    rod = Rod.from_paper_parameters(0.3, **base)
    assert rod.paper_parameters() == pytest.approx(base)


def test_a_random_cast_keeps_the_arms_limits_and_nearly_the_speed(arm):
    rng = np.random.default_rng(0)
    for _ in range(5):
        cast = random_cast(arm, rng, 200.0, 2.0)
        assert (np.diff(cast.frames) > 0.004).all()
        assert (cast.angles > arm.lowest).all()
        assert (cast.angles < arm.highest).all()
        steps = np.diff(arm.grasp_pose(cast.angles)[:, :2], axis=0)
        speed = np.linalg.norm(steps, axis=1).max() / (cast.fine[1] - cast.fine[0])
        assert 1.0 < speed < 2.3
        at_log = np.stack([np.interp(cast.t, cast.fine, q) for q in cast.angles.T], -1)
        assert np.abs(at_log - cast.reported).max() < 1e-3


def test_names_of_causes_are_the_librarys_or_no_effects():
    names = [cause.name for cause in LIBRARY_CAUSES]
    names += [other for cause in LIBRARY_CAUSES for other in cause.alike]
    assert set(names) <= set(effects_by_name())
    assert not {cause.name for cause in OUTSIDE_CAUSES} & set(effects_by_name())
    assert len({cause.name for cause in OUTSIDE_CAUSES}) == len(OUTSIDE_CAUSES)
    laws = {effect.name for effect in OUTSIDE_EFFECTS}
    assert laws <= {cause.name for cause in OUTSIDE_CAUSES}


def test_a_simulator_whose_package_is_missing_says_which(monkeypatch):
    monkeypatch.setitem(sys.modules, "elastica", None)
    module = "tests.benchmarks.simulators.pyelastica"
    monkeypatch.delitem(sys.modules, module, raising=False)
    words = r"simulator pyelastica: it needs elastica.*pip install pyelastica"
    with pytest.raises(DataError, match=words):
        load_simulator.__wrapped__("pyelastica")
