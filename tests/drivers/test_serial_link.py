"""The real driver with an emulated device on a pseudo-terminal, also with faults."""

import os
import random
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
from rig import ARM, DRIVING, WATCHDOG, driver, emulator, events, movement, standstill

from stringcast.data.artifacts import LINK, SENT_SPEEDS, TICKS
from stringcast.hardware.arm import VelocityArm
from stringcast.hardware.serial.emulator.device import FAULT_KINDS
from stringcast.hardware.serial.protocol import PROTOCOL_VERSION
from stringcast.hardware.serial.wire import SerialWire
from stringcast.stages.execute.interfaces import HardwareError

# [s] from the last command to rest; measured 0.05 s of device time
SWINGS_OUT = 0.15
SURVIVED = tuple(
    kind for kind in FAULT_KINDS if kind not in ("freeze", "unplug", "brownout", "jump")
)


@pytest.fixture
def log(tmp_path):
    return tmp_path / "events.jsonl"


def test_movement_is_performed_and_logged_tick_by_tick(log):
    # device clock and sequence numbers wrap during the movement
    with emulator(log, "--since", str(2**32 - 200_000)) as port:
        arm = driver(port)
        arm.wire.sequence = 2**16 - 80
        with arm:
            performance = arm.perform(movement())
            ended = arm.angles()
        assert standstill(log, "moving") is not None
    ticks = TICKS.check(performance.ticks)
    LINK.check(performance.link)
    assert len(ticks) == len(movement())
    np.testing.assert_allclose(ended, [0.5, -0.4, 0.6], atol=0.1)
    np.testing.assert_array_equal(
        ticks[list(SENT_SPEEDS)].to_numpy(),
        movement().filter(like="w").astype("float32"),
    )
    assert (ticks["t_sent"] >= ticks["t_due"]).all()
    answered = ticks.dropna(subset="t_acknowledged")
    # frames may arrive together
    assert (np.diff(answered["t_device"]) >= 0).all()
    assert np.ptp(answered["t_device"]) < 60.0
    assert performance.arm["t"].is_monotonic_increasing
    assert {"trip_p50", "trip_p99", "trip_max"} <= set(performance.link)


def test_move_to_is_slow(log):
    with emulator(log) as port, driver(port) as arm:
        arm.move_to([0.3, 0.2, -0.3])
        np.testing.assert_allclose(arm.angles(), [0.3, 0.2, -0.3], atol=0.05)


@pytest.mark.parametrize("kind", SURVIVED)
def test_single_frame_faults_are_tolerated_and_counted(log, kind):
    frame = random.Random(kind).randrange(60)
    with emulator(log, "--fault", f"{kind}:{frame}") as port:
        with driver(port) as arm:
            performance = arm.perform(movement())
        assert standstill(log, kind) is not None
    lost = performance.ticks["t_acknowledged"].isna()
    if kind.endswith(("drop", "corrupt")):
        assert lost.iloc[frame]
    assert performance.ticks["missed"][lost].all()


@pytest.mark.parametrize("kind", ["freeze", "unplug", "brownout", "jump"])
def test_device_fault_stops_the_arm_with_one_error(log, kind):
    frame = random.Random(kind).randrange(5, 55)
    said = r"no answer|link is gone|does not answer|restarted|watchdog|jumped"
    # a slow arm, so that encoder changes stay small even after a pause
    slow = replace(ARM, speed=(3.0,) * 3)
    with emulator(log, "--fault", f"{kind}:{frame}") as port:
        with pytest.raises(HardwareError, match=said), driver(port, slow) as arm:
            arm.perform(movement(0.6))
        took = standstill(log, kind)
    assert took is not None
    assert took < WATCHDOG + SWINGS_OUT


def test_too_many_late_ticks_invalidate_the_trial(log):
    with emulator(log) as port, driver(port, late=1e-9, most_missed=0.0) as arm:
        link = arm.perform(movement()).link.iloc[0]
    assert not link["valid"]
    assert "were late or lost, allowed are 0.0%" in link["reason"]


class EmergencyStopWire(SerialWire):
    """A wire that presses the emergency stop when the arm starts to move."""

    press_emergency_stop = staticmethod(lambda reason: None)

    def send(self, speeds):
        if any(speeds):
            self.press_emergency_stop("button")
        return super().send(speeds)


def test_emergency_stop_latches_host_and_device(log):
    with emulator(log) as port:
        wire = EmergencyStopWire(port, 1_000_000)
        pressed = VelocityArm(ARM, wire, DRIVING)
        wire.press_emergency_stop = pressed.press_emergency_stop
        with (
            pytest.raises(HardwareError, match=r"emergency stop \(button\)"),
            pressed as arm,
        ):
            arm.perform(movement())
        assert standstill(log, "latched") < SWINGS_OUT
        clear = [sys.executable, "-m", "stringcast.hardware.serial.clear", port]
        subprocess.run(clear, input="no\n", text=True, check=False, capture_output=True)
        with (
            pytest.raises(HardwareError, match=r"latched.*hardware\.serial\.clear"),
            driver(port),
        ):
            pass
        subprocess.run(clear, input="yes\n", text=True, check=True, capture_output=True)
        with driver(port) as arm:
            arm.press_emergency_stop("button")
            with pytest.raises(HardwareError, match="latched by the emergency stop"):
                arm.move_to([0.1, 0.1, 0.1])
            arm.clear()
            arm.move_to([0.1, 0.1, 0.1])


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP", "SIGKILL"])
def test_killed_host_leaves_the_arm_at_rest(log, name):
    script = (
        "import sys; sys.path.insert(0, 'tests/drivers'); import rig\n"
        "with rig.driver(sys.argv[1]) as arm: arm.perform(rig.movement(3.0))\n"
    )
    with emulator(log) as port:
        host = subprocess.Popen(
            [sys.executable, "-c", script, port], stderr=subprocess.DEVNULL
        )
        end = time.monotonic() + 20
        while (
            "moves" not in {e["event"] for e in events(log)} and time.monotonic() < end
        ):
            time.sleep(0.02)
        os.kill(host.pid, getattr(signal, name))
        host.wait(timeout=10)
        if name == "SIGKILL":
            assert standstill(log, "tripped") < SWINGS_OUT
        else:
            assert standstill(log, "latched") < SWINGS_OUT
            assert "tripped" not in {e["event"] for e in events(log)}


def test_host_of_another_version_is_refused(log, monkeypatch):
    monkeypatch.setattr(
        "stringcast.hardware.serial.wire.PROTOCOL_VERSION", PROTOCOL_VERSION + 1
    )
    with (
        emulator(log) as port,
        pytest.raises(
            HardwareError, match=f"speaks version {PROTOCOL_VERSION} for 3 joints"
        ),
        driver(port),
    ):
        pass


def test_missing_device_gives_one_clear_error():
    with pytest.raises(HardwareError, match=r"hardware.port"), driver("/dev/nowhere"):
        pass
