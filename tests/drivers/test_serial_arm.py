"""The real driver against a device on a real pseudo-terminal, well and ill."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pandas as pd
import pytest

from data.artifacts import JOINTS, LINK, SPEEDS, TICKS
from hardware.serial.arm import SerialArm, check_movement
from hardware.serial.protocol import (
    VELOCITY,
    Answer,
    Command,
    FrameError,
    cobs,
    decode_answer,
    decode_command,
    encode_answer,
    encode_command,
    uncobs,
)
from stages.model.arm import Arm
from stages.roles import HardwareError

ARM = Arm((0.25, 0.2, 0.135), (0.0, 0.0), (-2.0,) * 3, (2.0,) * 3, (20.0,) * 3, (300.0,) * 3, 21.8, 0.005)


@pytest.fixture
def device(tmp_path):
    """Start an emulated device with faults; stop it at the end."""
    running = []

    def start(*faults):
        log = tmp_path / "state.json"
        options = [part for fault in faults for part in ("--fault", fault)]
        command = [sys.executable, "-m", "hardware.serial.emulator", "--log", str(log), "--until", "20", *options]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        running.append(process)
        assert process.stdout is not None
        return process.stdout.readline().strip(), log

    yield start
    for process in running:
        process.kill()
        process.wait()


def driver(port):
    return SerialArm(ARM, port, 1_000_000, misses=8, late=0.05, most_missed=0.05, approach=2.0, settle=0.0)


def movement(duration=0.3):
    t = np.arange(0, duration + 1e-9, 0.005)
    q = np.stack([a * (1 - np.cos(np.pi * t / duration)) / 2 for a in (0.5, -0.4, 0.6)], axis=-1)
    w = np.concatenate([np.diff(q, axis=0) / 0.005, np.zeros((1, 3))])
    return pd.DataFrame({"t": t} | dict(zip(JOINTS, q.T, strict=True)) | dict(zip(SPEEDS, w.T, strict=True)))


def rests(log) -> bool:
    """The device's own log says that its joints stand still."""
    for _ in range(40):
        state = json.loads(log.read_text())
        if max(map(abs, state["speed"])) < 1e-3 and not any(state["target"]):
            return True
        time.sleep(0.05)
    return False


@pytest.mark.parametrize("data", [b"", b"\0", b"\0\0", b"abc", bytes(range(256)) * 3, b"\1" * 254, b"\1" * 255])
def test_stuffing_has_no_zero_and_undoes_itself(data):
    assert 0 not in cobs(data)
    assert uncobs(cobs(data)) == data


def test_frames_come_back_and_damaged_ones_do_not():
    command = Command(VELOCITY, 513, (1.5, -2.25, 0.0))
    frame = encode_command(command)
    assert decode_command(frame[:-1]) == command
    answer = Answer(7, 1.25, True, (0.5, 0.25, -1.0))
    wire = encode_answer(answer)
    assert decode_answer(wire[:-1]) == answer
    for i in range(len(wire) - 1):
        for bit in range(8):
            damaged = bytearray(wire[:-1])
            damaged[i] ^= 1 << bit
            with pytest.raises(FrameError):
                decode_answer(bytes(damaged))


def test_a_movement_arrives_and_is_logged_tick_by_tick(device):
    port, log = device()
    with driver(port) as arm:
        performance = arm.perform(movement())
        ended = arm.angles()
    TICKS.check(performance.ticks)
    LINK.check(performance.link)
    assert len(performance.ticks) == len(movement())
    np.testing.assert_allclose(ended, [0.5, -0.4, 0.6], atol=0.05)
    assert performance.arm["t"].is_monotonic_increasing
    assert rests(log)


def test_move_to_goes_there_slowly(device):
    port, log = device()
    with driver(port) as arm:
        arm.move_to([0.3, 0.2, -0.3])
        np.testing.assert_allclose(arm.angles(), [0.3, 0.2, -0.3], atol=0.02)
    assert rests(log)


@pytest.mark.parametrize("kind", ["drop", "corrupt", "duplicate", "delay"])
@pytest.mark.parametrize("frame", [0, 25, 59])
def test_a_single_fault_is_survived_and_accounted_for(device, kind, frame):
    port, log = device(f"{kind}:{frame}")
    with driver(port) as arm:
        performance = arm.perform(movement())
    lost = performance.ticks["t_acknowledged"].isna()
    if kind in ("drop", "corrupt"):
        assert lost.iloc[frame]
    assert performance.ticks["missed"][lost].all()
    assert rests(log)


@pytest.mark.parametrize("frame", [3, 30])
@pytest.mark.parametrize("kind", ["freeze", "unplug"])
def test_a_dead_link_ends_with_the_arm_at_rest_and_one_error(device, kind, frame):
    port, log = device(f"{kind}:{frame}")
    with pytest.raises(HardwareError, match=r"no answer|link is gone|does not answer"), driver(port) as arm:
        arm.perform(movement())
    assert kind == "unplug" or rests(log)


def test_a_wrong_start_is_refused_before_anything_moves(device):
    port, log = device("jump:0")
    shifted = movement()
    shifted["q1"] += 0.1
    with pytest.raises(HardwareError, match="degrees from the movement's start"), driver(port) as arm:
        arm.perform(shifted)
    assert json.loads(log.read_text())["angle"] == [0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("change", "limit"),
    [(3.0, "range"), (0.12, "arm.speed"), (0.01, "arm.acceleration")],
    ids=["range", "speed", "acceleration"],
)
def test_limits_are_checked_on_the_whole_movement(change, limit):
    angles = np.zeros((40, 3))
    angles[20:, 0] = change
    with pytest.raises(HardwareError, match=limit):
        check_movement(ARM, angles)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_killing_the_host_leaves_the_arm_at_rest(device, number, tmp_path):
    port, log = device()
    script = (
        "import sys; sys.path.insert(0, 'tests/drivers'); import test_serial_arm as t\n"
        f"with t.driver({port!r}) as arm:\n    print('moving', flush=True)\n    arm.perform(t.movement(1.5))\n"
    )
    host = subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    assert host.stdout is not None
    host.stdout.readline()
    time.sleep(0.5)
    assert max(map(abs, json.loads(log.read_text())["speed"])) > 0.01
    os.kill(host.pid, number)
    host.wait(timeout=5)
    assert rests(log)


def test_no_device_is_one_clear_error():
    with pytest.raises(HardwareError, match=r"hardware.port"), driver("/dev/nowhere"):
        pass
