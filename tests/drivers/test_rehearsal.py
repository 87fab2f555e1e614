"""Rehearsals: no movement, slow movement, or an emulated arm."""

import subprocess
from dataclasses import replace

import numpy as np
import pytest
from conftest import specimen, swing
from rig import DRIVING, WORKSPACE

from stringcast.data.artifacts import JOINTS, SPEEDS
from stringcast.data.images import encode_png
from stringcast.hardware.camera import ImageFolder
from stringcast.hardware.serial.rehearsal import open_lab
from stringcast.hardware.virtual.bench import VirtualArm, VirtualBench, VirtualCamera
from stringcast.hardware.virtual.obstacles import Obstacles
from stringcast.hardware.virtual.render import Look
from stringcast.hardware.virtual.servo import VirtualServo
from stringcast.stages.execute.dry_run import dry_run, slow_commands, slow_run
from stringcast.stages.execute.execute import execute
from stringcast.stages.execute.interfaces import HardwareError

START = [-0.9, 0.6, 0.4]


@pytest.fixture
def bench(arm, camera):
    small = replace(
        camera, width=64, height=64, px_per_m=34.0, origin_px=(25.0, 38.0), fps=50.0
    )
    return VirtualBench(arm, small, specimen("A"), seed=3)


def test_slowed_movement_keeps_its_path():
    whole = swing().commands
    for share in (0.2, 0.37, 0.9):
        slower = slow_commands(whole, share)
        q, w = slower[list(JOINTS)].to_numpy(), slower[list(SPEEDS)].to_numpy()
        np.testing.assert_allclose(np.diff(slower["t"]), 0.005)
        np.testing.assert_allclose(q[[0, -1]], whole[list(JOINTS)].to_numpy()[[0, -1]])
        np.testing.assert_allclose(q[:-1] + 0.005 * w[:-1], q[1:], atol=1e-12)
        fastest = np.abs(whole[list(SPEEDS)]).max().to_numpy()
        assert (np.abs(w).max(axis=0) <= share * fastest + 1e-9).all()
        assert (
            np.abs(np.diff(w, axis=0)).max()
            <= np.abs(np.diff(whole[list(SPEEDS)], axis=0)).max() + 1e-9
        )


def test_slow_run_ends_at_the_same_pose_and_is_invalid(bench):
    trial = slow_run(
        swing(),
        VirtualArm(bench),
        VirtualCamera(bench),
        before=0.1,
        after=0.1,
        share=0.5,
    )
    ended = swing().commands[list(JOINTS)].iloc[-1]
    np.testing.assert_allclose(trial.arm[list(JOINTS)].iloc[-1], ended, atol=0.02)
    assert trial.frames["t"].iloc[-1] == pytest.approx(1.1, abs=0.03)
    assert not trial.link["valid"].iloc[0]
    assert trial.link["reason"].iloc[0] == "dry run at 0.5 of the speed"


def test_dry_run_films_an_arm_at_rest(bench):
    bench.pose = np.array(START) + 0.3
    trial = dry_run(
        swing(), VirtualArm(bench), VirtualCamera(bench), before=0.1, after=0.1
    )
    np.testing.assert_allclose(
        trial.arm[list(JOINTS)] - (np.array(START) + 0.3), 0, atol=1e-4
    )
    assert len(trial.images) == pytest.approx(0.7 * 50, abs=2)
    assert not trial.link["valid"].iloc[0]
    assert "disabled" in trial.link["reason"].iloc[0]


@pytest.fixture
def emulators(monkeypatch):
    """Collect the processes of emulated devices."""
    processes = []

    class RecordedProcess(subprocess.Popen):
        def __init__(self, *args, **options):
            super().__init__(*args, **options)
            processes.append(self)

    monkeypatch.setattr(subprocess, "Popen", RecordedProcess)
    return processes


@pytest.fixture
def rehearsal(bench):
    settings = {
        "specimen": bench.specimen,
        "servo": VirtualServo(),
        "look": Look(),
        "obstacles": Obstacles(),
    }
    driving = replace(
        DRIVING,
        workspace=replace(WORKSPACE, low=(-0.5, -0.5), high=(0.9, 0.9)),
        approach=3.0,
    )

    def lab(faults=(), source=None, most_lost=0.02):
        more = {
            "driving": driving,
            "watchdog": 250,
            "faults": list(faults),
            "source": source,
            "most_lost": most_lost,
        }
        return open_lab(bench.arm, bench.camera, seed=3, trial=1, **settings, **more)

    return lab


def test_emulated_arm_moves_the_virtual_string(rehearsal, emulators):
    lab = rehearsal()
    trial = execute(swing(), lab.arm, lab.camera, before=0.1, after=0.1)
    ended = swing().commands[list(JOINTS)].iloc[-1]
    np.testing.assert_allclose(trial.arm[list(JOINTS)].iloc[-1], ended, atol=0.3)
    assert len(trial.images) == pytest.approx(0.7 * 50, abs=3)
    performed = lab.camera.bench.performed_motion
    np.testing.assert_array_equal(performed[1], trial.arm[list(JOINTS)])
    (emulator,) = emulators
    assert emulator.poll() is not None


def test_real_camera_films_the_emulated_arm(rehearsal, bench, tmp_path):
    """The camera plays a folder of images."""
    image = np.zeros((bench.camera.height, bench.camera.width), np.uint8)
    for number in range(200):
        image[number % 64] = number
        (tmp_path / f"{number:03d}.png").write_bytes(encode_png(image))
    lab = rehearsal(source=ImageFolder(tmp_path), most_lost=0.5)
    trial = execute(swing(), lab.arm, lab.camera, before=0.1, after=0.1)
    assert len(trial.images) == pytest.approx(0.7 * 50, abs=5)
    assert trial.images[-1].max() > trial.images[0].max()
    ended = swing().commands[list(JOINTS)].iloc[-1]
    np.testing.assert_allclose(trial.arm[list(JOINTS)].iloc[-1], ended, atol=0.3)


def test_dry_run_sends_only_zero_velocities(rehearsal):
    lab = rehearsal()
    trial = dry_run(swing(), lab.arm, lab.camera, before=0.1, after=0.1)
    assert (trial.ticks[[f"sent{j}" for j in (1, 2, 3)]] == 0).all(axis=None)
    np.testing.assert_allclose(trial.arm[list(JOINTS)], 0, atol=1e-9)
    too_fast = swing(speeds=(60.0, 0.0, 0.0))
    with pytest.raises(HardwareError, match=r"leaves arm\."):
        dry_run(too_fast, lab.arm, lab.camera, before=0.1, after=0.1)


def test_emulated_fault_raises_the_real_error(rehearsal, emulators):
    lab = rehearsal(["brownout:400"])
    with pytest.raises(HardwareError, match=r"restarted|no answer"):
        execute(
            swing(3.0, speeds=(0.3, 0.2, 0.1)),
            lab.arm,
            lab.camera,
            before=0.1,
            after=0.1,
        )
    (emulator,) = emulators
    assert emulator.poll() is not None
