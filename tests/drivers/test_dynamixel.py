"""The Dynamixel driver with an emulated bus and the maker's library."""

import math
import os
import pty
import subprocess
import sys
import threading
import time
import tty
from contextlib import contextmanager
from dataclasses import dataclass, replace
from io import StringIO

import numpy as np
import pytest
from rig import ARM, DRIVING, emulator, events, movement, standstill

from stringcast.data.artifacts import LINK, SENT_SPEEDS, TICKS
from stringcast.data.lazy_module import LazyModule, MissingPackageError
from stringcast.hardware.arm import Driving, VelocityArm
from stringcast.hardware.dynamixel.bus import DynamixelBus, ServoSettings
from stringcast.hardware.dynamixel.emulator.bus import LIMIT, EmulatedBus
from stringcast.hardware.dynamixel.emulator.bus import EmulatedServo as Emulated
from stringcast.hardware.dynamixel.emulator.packets import (
    PacketSplitter,
    crc16,
    status_packet,
)
from stringcast.hardware.dynamixel.registers import (
    ACCELERATION_UNIT,
    BUS_WATCHDOG,
    DRIVE_MODE,
    GOAL_VELOCITY,
    OPERATING_MODE,
    PROFILE_ACCELERATION,
    TORQUE_ENABLE,
    VELOCITY_LIMIT,
    VELOCITY_MODE,
    VELOCITY_UNIT,
    WATCHDOG_TRIPPED,
)
from stringcast.hardware.emulated.joints import STEP_S
from stringcast.hardware.emulated.terminal import _exchange_bytes
from stringcast.stages.execute.interfaces import HardwareError

sdk = pytest.importorskip("dynamixel_sdk")

SERVOS = (
    ServoSettings(1, 2048, 1),
    ServoSettings(2, 2048, -1),
    ServoSettings(3, 2048, 1),
)
EMULATOR = (sys.executable, "-m", "stringcast.hardware.dynamixel.emulator")
PATIENCE = 15  # 0.3 s, for busy machines
SWINGS_OUT = 0.15


def driver(port, servos=SERVOS, patience=PATIENCE, fastest=ARM.speed, **changed):
    bus = DynamixelBus(port, 1_000_000, servos, fastest, reply=0.2, patience=patience)
    return VelocityArm(ARM, bus, Driving(**{**vars(DRIVING), **changed}))


@pytest.fixture
def log(tmp_path):
    return tmp_path / "events.jsonl"


def bus(log, *options):
    return emulator(log, *options, command=EMULATOR, watchdog=None)


def test_packets_equal_those_of_the_makers_library():
    """The library computes CRC and stuffing by tables; the emulator bit by bit."""
    library = sdk.Protocol2PacketHandler()
    rng = np.random.default_rng(0)
    for size in (1, 10, 60):
        data = rng.bytes(size)
        assert crc16(data) == library.updateCRC(0, list(data), size)
    parameters = [0x40, 0, 0xFF, 0xFF, 0xFD, 7]
    packet = [0, 0, 0, 0, 1, len(parameters) + 3, 0, 0x03, *parameters, 0, 0]
    written = []

    class Port:
        is_using = False

        def clearPort(self):  # noqa: N802
            pass

        def writePort(self, data):  # noqa: N802
            written.extend(data)
            return len(data)

    assert library.txPacket(Port(), packet) == sdk.COMM_SUCCESS
    torn = PacketSplitter()
    found = [
        p for byte in b"noise" + bytes(written) for p in torn.packets(bytes([byte]))
    ]
    assert [(p.id, p.instruction, list(p.parameters)) for p in found] == [
        (1, 3, parameters)
    ]
    damaged = bytearray(written)
    damaged[9] ^= 4
    assert PacketSplitter().packets(bytes(damaged)) == []
    assert (
        library.removeStuffing(list(status_packet(1, 0, bytes(parameters))))[9:15]
        == parameters
    )


def test_movement_is_performed_and_logged_tick_by_tick(log):
    with bus(log) as port:
        with driver(port) as arm:
            performance = arm.perform(movement())
            ended = arm.angles()
        assert standstill(log, "moves") is not None
        # the second servo is mounted in reverse
        assert events(log)[-1]["angles"][1] > 0.3
    ticks = TICKS.check(performance.ticks)
    LINK.check(performance.link)
    np.testing.assert_allclose(ended, [0.5, -0.4, 0.6], atol=0.1)
    sent = ticks[list(SENT_SPEEDS)].to_numpy()
    asked = movement().filter(like="w").to_numpy()
    np.testing.assert_allclose(
        sent / VELOCITY_UNIT, np.rint(sent / VELOCITY_UNIT), atol=1e-9
    )
    # speeds are rounded to 0.024 rad/s, but the displacement is exact
    assert np.abs(np.cumsum(sent - asked, axis=0)).max() <= VELOCITY_UNIT / 2 + 1e-9
    assert performance.arm["t"].is_monotonic_increasing


def test_torque_is_off_after_closing(log):
    with bus(log) as port:
        with driver(port) as arm:
            arm.move_to([0.1, 0.1, 0.1])
        plain = DynamixelBus(port, 1_000_000, SERVOS, ARM.speed, 0.2, PATIENCE)
        plain._connect()
        assert [plain._read(servo, TORQUE_ENABLE) for servo in SERVOS] == [0, 0, 0]
        assert [plain._read(servo, BUS_WATCHDOG) for servo in SERVOS] == [0, 0, 0]
        plain.close()


def test_lost_velocity_is_tolerated(log):
    with bus(log, "--fault", "drop:30") as port, driver(port) as arm:
        np.testing.assert_allclose(
            arm.perform(movement()).arm.iloc[-1][["q1", "q3"]], [0.5, 0.6], atol=0.15
        )


@pytest.mark.parametrize("kind", ["freeze", "unplug", "brownout"])
def test_bus_fault_stops_the_arm_with_one_error(log, kind):
    with bus(log, "--fault", f"{kind}:40") as port:
        said = r"watchdog|restarted|no answer|link is gone|do not answer"
        with pytest.raises(HardwareError, match=said), driver(port) as arm:
            arm.perform(movement(1.0))
        took = standstill(log, kind)
    assert took is not None
    assert took < PATIENCE * 0.02 + SWINGS_OUT


class InterruptedArm(VelocityArm):
    """A driver that is interrupted in mid-movement."""

    @property
    def latch_reason(self):
        """The reason to stop, read before each velocity."""
        if self.is_moving and self.wire.command_number > 20:
            raise KeyboardInterrupt
        return self.why

    @latch_reason.setter
    def latch_reason(self, why):
        self.why = why


def test_emergency_stop_latches_the_servos_until_cleared(log):
    with bus(log) as port:
        with (
            pytest.raises(KeyboardInterrupt),
            InterruptedArm(ARM, driver(port).wire, DRIVING) as arm,
        ):
            arm.perform(movement())
        assert "tripped" in {e["event"] for e in events(log)}
        for _ in range(2):  # a refusal must not clear the latch
            with (
                pytest.raises(
                    HardwareError, match=r"latched.*hardware\.dynamixel\.clear .* 1 2 3"
                ),
                driver(port),
            ):
                pass
        clear = [
            sys.executable,
            "-m",
            "stringcast.hardware.dynamixel.clear",
            port,
            "1",
            "2",
            "3",
            "--baud",
            "1000000",
        ]
        subprocess.run(clear, input="yes\n", text=True, check=True, capture_output=True)
        with driver(port) as arm:
            arm.move_to([0.1, 0.0, 0.0])


def test_missing_commands_trip_the_watchdogs(log):
    with bus(log) as port, driver(port, patience=2) as arm:
        arm.wire.send(np.array([0.5, 0.0, 0.0]))
        arm.wire.answers()
        assert standstill(log, "tripped") is not None
        there = arm.angles()
        arm.wire.send(np.array([0.5, 0.0, 0.0]))
        assert "watchdog" in arm.wire.answers()[0].hold_reason
        np.testing.assert_array_equal(arm.angles(), there)
        arm.wire.stop()
        # a stop does not clear the watchdog
        assert arm.wire._read(SERVOS[0], BUS_WATCHDOG) == WATCHDOG_TRIPPED


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        (
            {"servos": (*SERVOS[:2], ServoSettings(9, 2048, 1))},
            r"servo 9: .*no status packet",
        ),
        ({"fastest": (100.0,) * 3}, r"60\.\d+ rad/s at most .*, arm\.speed is 100"),
    ],
)
def test_unsuitable_servos_give_one_clear_error(log, changed, words):
    with (
        bus(log) as port,
        pytest.raises(HardwareError, match=words),
        driver(port, **changed),
    ):
        pass


@contextmanager
def serve_servos(servos):
    """Serve these servos in a thread and return the name of the port."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    ended = threading.Event()
    there = threading.Thread(
        target=_exchange_bytes,
        args=(
            EmulatedBus({}, StringIO(), servos),
            master,
            time.monotonic() + 60,
            ended,
        ),
    )
    there.start()
    try:
        yield os.ttyname(slave)
    finally:
        ended.set()
        there.join()
        os.close(slave)
        os.close(master)


@dataclass
class DeafServo(Emulated):
    """A servo that acknowledges some writes without storing the value.

    written: addresses in order.
    """

    keeps: tuple[int, ...] = ()

    def __post_init__(self):
        super().__post_init__()
        self.written = []

    def write(self, address, data):
        self.written.append(address)
        kept = (
            bytes(self.table[address : address + len(data)])
            if address in self.keeps
            else data
        )
        return super().write(address, kept)


SLOW = replace(ARM, speed=(4.0, 5.0, 6.0), acceleration=(30.0, 40.0, 50.0))


def slow(port):
    return VelocityArm(
        SLOW, DynamixelBus(port, 1_000_000, SERVOS, SLOW.speed, 0.2, PATIENCE), DRIVING
    )


def test_all_servos_get_the_limits_and_the_permanent_one_once():
    servos = {i: DeafServo() for i in (1, 2, 3)}
    with serve_servos(servos) as port:
        for _ in range(2):
            with slow(port):
                held = [
                    [s.get(r) for s in servos.values()]
                    for r in (VELOCITY_LIMIT, PROFILE_ACCELERATION)
                ]
    per_unit = ((SLOW.speed, VELOCITY_UNIT), (SLOW.acceleration, ACCELERATION_UNIT))
    assert held == [
        [math.ceil(limit / unit) for limit in limits] for limits, unit in per_unit
    ]
    for servo in servos.values():
        assert servo.get(OPERATING_MODE) == VELOCITY_MODE
        assert (
            servo.written.count(VELOCITY_LIMIT.address)
            == servo.written.count(OPERATING_MODE.address)
            == 1
        )


@pytest.mark.parametrize(
    "register", [VELOCITY_LIMIT, PROFILE_ACCELERATION, OPERATING_MODE]
)
def test_servo_that_keeps_an_old_value_is_refused_before_a_movement(
    register,
):
    servos = {1: DeafServo(), 2: DeafServo(keeps=(register.address,)), 3: DeafServo()}
    with serve_servos(servos) as port:
        with pytest.raises(
            HardwareError,
            match=rf"servo 2 holds \d+ in register {register.address} where \d+ was",
        ):
            slow(port).__enter__()
        until = time.monotonic() + 5.0  # the last commands have no answer
        while (
            any(servo.get(TORQUE_ENABLE) for servo in servos.values())
            and time.monotonic() < until
        ):
            time.sleep(0.01)
        assert not any(
            servo.get(TORQUE_ENABLE) or servo.get(GOAL_VELOCITY)
            for servo in servos.values()
        )
    assert all(servo.joint.angle == 0.0 for servo in servos.values())


def test_servo_with_time_based_profile_is_refused():
    servos = {i: DeafServo() for i in (1, 2, 3)}
    servos[3].set(DRIVE_MODE, 4)
    with (
        serve_servos(servos) as port,
        pytest.raises(HardwareError, match=r"servo 3 takes accelerations as times"),
    ):
        slow(port).__enter__()
    assert PROFILE_ACCELERATION.address not in servos[3].written


def test_velocities_are_clamped_and_none_is_sent_before_limits():
    servos = {i: DeafServo() for i in (1, 2, 3)}
    with serve_servos(servos) as port:
        plain = DynamixelBus(port, 1_000_000, SERVOS, SLOW.speed, 0.2, PATIENCE)
        plain.open()
        assert plain.send(np.full(3, 1.0))[1].tolist() == [0.0, 0.0, 0.0]
        plain.set_limits(SLOW)
        _, carried = plain.send(np.array([1e6, -1e6, 1.0]))
        plain.answers()  # answering servos have read the command
        told = [servo.get(GOAL_VELOCITY) for servo in servos.values()]
        plain.close()
    assert told == [
        math.ceil(4.0 / VELOCITY_UNIT),
        math.ceil(5.0 / VELOCITY_UNIT),
        round(1.0 / VELOCITY_UNIT),
    ]
    np.testing.assert_allclose(carried, np.array(told) * VELOCITY_UNIT * [1, -1, 1])


def test_servos_enforce_their_limits():
    """A servo refuses goals beyond its limit and approaches others by its profile."""
    servo = Emulated()
    for register, value in (
        (OPERATING_MODE, 1),
        (VELOCITY_LIMIT, 100),
        (PROFILE_ACCELERATION, 20),
    ):
        assert (
            servo.write(register.address, value.to_bytes(register.size, "little")) == 0
        )
    servo.write(TORQUE_ENABLE.address, b"\1")
    for goal in (101, -101, 2**31 - 1):
        assert (
            servo.write(GOAL_VELOCITY.address, goal.to_bytes(4, "little", signed=True))
            == LIMIT
        )
        assert servo.get(GOAL_VELOCITY) == 0
    assert (
        servo.write(GOAL_VELOCITY.address, (-100).to_bytes(4, "little", signed=True))
        == 0
    )
    speeds = [0.0]
    for k in range(1000):
        servo.step(k * STEP_S)
        speeds.append(servo.speed)
    assert speeds[-1] == pytest.approx(-100 * VELOCITY_UNIT)
    assert np.abs(np.diff(speeds)).max() == pytest.approx(
        20 * ACCELERATION_UNIT * STEP_S
    )


def test_missing_bus_gives_one_clear_error():
    with pytest.raises(HardwareError, match=r"hardware\.port"), driver("/dev/nowhere"):
        pass


def test_missing_library_gives_one_clear_error(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "dynamixel_sdk", None)
    monkeypatch.setattr(
        "stringcast.hardware.dynamixel.bus.dynamixel_sdk", LazyModule("dynamixel_sdk")
    )
    with (
        pytest.raises(MissingPackageError, match="pip install dynamixel-sdk"),
        driver(str(tmp_path / "port")),
    ):
        pass
