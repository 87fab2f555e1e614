"""Frames and state machine of the device, with a simulated clock."""

import pytest
from rig import ARM

from stringcast.hardware.serial.firmware import Firmware
from stringcast.hardware.serial.protocol import (
    MAX_FRAME_BYTES,
    PROTOCOL_VERSION,
    Command,
    Deframer,
    DeviceState,
    FrameError,
    FrameKind,
    Greeting,
    LimitsAnswer,
    Report,
    decode_answer,
    decode_cobs,
    decode_command,
    encode_answer,
    encode_cobs,
    encode_command,
    is_newer,
)
from stringcast.hardware.serial.wire import SerialWire, check_latency
from stringcast.stages.execute.interfaces import HardwareError

LIMITS = (*(4.0,) * 3, *(300.0,) * 3, 5000, 25)  # [rad/s], [rad/s^2], [us], [ms]
POSE = (0.5, 0.25, -1.0)


def send_command(firmware, kind, sequence, values=(), micros=0):
    answer = firmware.receive(
        encode_command(Command(kind, sequence, values)), micros, POSE
    )
    return decode_answer(answer[:-1])


@pytest.fixture
def firmware():
    device = Firmware()
    send_command(device, FrameKind.HELLO, 1, (PROTOCOL_VERSION,))
    send_command(device, FrameKind.LIMITS, 1, LIMITS)
    return device


@pytest.mark.parametrize(
    "data",
    [b"", b"\0", b"\0\0", b"abc", bytes(range(256)) * 3, b"\1" * 254, b"\1" * 255],
)
def test_cobs_has_no_zeros_and_is_invertible(data):
    assert 0 not in encode_cobs(data)
    assert decode_cobs(encode_cobs(data)) == data


def test_frames_are_decoded_and_damaged_ones_rejected():
    command = Command(FrameKind.VELOCITY, 513, (1.5, -2.25, 0.0))
    assert decode_command(encode_command(command)[:-1]) == command
    greeting = Greeting(9, PROTOCOL_VERSION, 3, 25, DeviceState.LATCHED)
    assert decode_answer(encode_answer(greeting)[:-1]) == greeting
    report = Report(7, 1_250_000, DeviceState.MOVING, POSE)
    wire = encode_answer(report)
    assert decode_answer(wire[:-1]) == report
    for i in range(len(wire) - 1):
        for bit in range(8):
            damaged = bytearray(wire[:-1])
            damaged[i] ^= 1 << bit
            with pytest.raises(FrameError):
                decode_answer(bytes(damaged))


@pytest.mark.parametrize("length", range(8))
def test_too_short_frames_are_rejected(length):
    for decode in (decode_command, decode_answer):
        with pytest.raises(FrameError):
            decode(encode_cobs(b"\x01" * length))


def test_longest_frame_is_kept_and_longer_ones_dropped():
    whole = b"\x01" * MAX_FRAME_BYTES
    assert Deframer().frames(whole + b"\0" + whole + b"\x01\0" + whole + b"\0") == [
        whole,
        whole,
    ]


def test_frames_are_split_independently_of_chunks():
    frames = [
        encode_command(Command(FrameKind.VELOCITY, n, POSE))[:-1] for n in range(3)
    ]
    stream = b"\0".join([*frames, b"x" * 500, b"", frames[0], b""])
    for size in (1, 2, 7, 64, 1000):
        cut = Deframer()
        found = [
            f
            for i in range(0, len(stream), size)
            for f in cut.frames(stream[i : i + size])
        ]
        assert found == [*frames, frames[0]]


@pytest.mark.parametrize(
    ("sequence", "last", "after"),
    [
        (1, 0, True),
        (0, 65535, True),
        (5, 65530, True),
        (0, 0, False),
        (65535, 0, False),
        (2**15 - 1, 0, True),
        (2**15, 0, False),
    ],
)
def test_sequence_numbers_wrap(sequence, last, after):
    assert is_newer(sequence, last) is after


def test_host_unwraps_the_device_clock_with_reordered_answers():
    wire = SerialWire("", 0)
    reported = [2**32 - 2000, 2**32 - 1000, 500, 2**32 - 500, 4000]
    times = [wire._unwrap_clock(micros) for micros in reported]
    assert [round((t - times[0]) * 1e6) for t in times] == [0, 1000, 2500, 1500, 6000]


def test_fresh_device_ignores_velocities_before_a_greeting():
    device = Firmware()
    assert send_command(device, FrameKind.VELOCITY, 1, POSE).state is DeviceState.FRESH
    assert device.target == (0.0, 0.0, 0.0)


def test_greeting_of_another_version_changes_nothing():
    device = Firmware()
    assert send_command(
        device, FrameKind.HELLO, 1, (PROTOCOL_VERSION + 1,)
    ) == Greeting(1, PROTOCOL_VERSION, 3, 25, DeviceState.FRESH)


def test_tripped_watchdog_stays_tripped_across_clock_wraps(firmware):
    start = 2**32 - 10_000
    send_command(firmware, FrameKind.VELOCITY, 2, POSE, start)
    firmware.tick((start + 25_000) % 2**32)
    assert firmware.state is DeviceState.MOVING
    firmware.tick((start + 25_001) % 2**32)
    assert firmware.state is DeviceState.TRIPPED
    assert (
        send_command(firmware, FrameKind.VELOCITY, 3, POSE, 20_000).state
        is DeviceState.TRIPPED
    )
    assert firmware.target == (0.0, 0.0, 0.0)
    assert (
        send_command(firmware, FrameKind.HELLO, 4, (PROTOCOL_VERSION,)).state
        is DeviceState.IDLE
    )


def test_watchdog_is_off_at_rest(firmware):
    firmware.tick(10_000_000)
    assert firmware.state is DeviceState.IDLE


def test_overtaken_commands_are_answered_but_not_obeyed(firmware):
    send_command(firmware, FrameKind.VELOCITY, 3, (1.0, 1.0, 1.0))
    assert send_command(firmware, FrameKind.VELOCITY, 2, (2.0, 2.0, 2.0)).sequence == 2
    assert firmware.target == (1.0, 1.0, 1.0)
    send_command(firmware, FrameKind.STOP, 5)
    assert (
        send_command(firmware, FrameKind.VELOCITY, 4, (2.0, 2.0, 2.0)).state
        is DeviceState.IDLE
    )
    assert firmware.target == (0.0, 0.0, 0.0)


def test_latched_device_obeys_only_clear(firmware):
    send_command(firmware, FrameKind.VELOCITY, 2, POSE)
    assert send_command(firmware, FrameKind.LATCH, 3).state is DeviceState.LATCHED
    for kind, values in (
        (FrameKind.VELOCITY, POSE),
        (FrameKind.STOP, ()),
        (FrameKind.HELLO, (PROTOCOL_VERSION,)),
        (FrameKind.PING, ()),
    ):
        assert send_command(firmware, kind, 4, values).state is DeviceState.LATCHED
        assert firmware.target == (0.0, 0.0, 0.0)
    assert send_command(firmware, FrameKind.CLEAR, 5).state is DeviceState.FRESH
    assert (
        send_command(firmware, FrameKind.VELOCITY, 6, POSE).state is DeviceState.FRESH
    )
    assert (
        send_command(firmware, FrameKind.HELLO, 7, (PROTOCOL_VERSION,)).state
        is DeviceState.IDLE
    )


@pytest.mark.parametrize("speed", [float("nan"), float("inf")])
def test_nan_speed_is_not_a_command(firmware, speed):
    assert (
        firmware.receive(
            encode_command(Command(FrameKind.VELOCITY, 2, (0.0, speed, 0.0))), 0, POSE
        )
        == b""
    )
    assert firmware.state is DeviceState.IDLE


def test_slow_adapter_is_refused_with_a_remedy(tmp_path):
    timer = tmp_path / "ttyUSB7" / "latency_timer"
    timer.parent.mkdir()
    timer.write_text("16\n")
    with pytest.raises(HardwareError, match=r"16 ms.*echo 1"):
        check_latency("/dev/ttyUSB7", tmp_path)
    timer.write_text("1\n")
    check_latency("/dev/ttyUSB7", tmp_path)


def send_limits(firmware, *values, sequence=1):
    return send_command(firmware, FrameKind.LIMITS, sequence, values).values


def test_nothing_moves_before_limits_are_set():
    device = Firmware()
    send_command(device, FrameKind.HELLO, 1, (PROTOCOL_VERSION,))
    assert (
        send_command(device, FrameKind.VELOCITY, 2, POSE).state is DeviceState.CLAMPED
    )
    assert device.target == (0.0, 0.0, 0.0)
    # limits are not accepted during movement
    assert send_limits(device, *LIMITS)[0] == 0.0
    send_command(device, FrameKind.STOP, 3)
    assert send_limits(device, *LIMITS) == LIMITS
    assert send_command(device, FrameKind.VELOCITY, 4, POSE).state is DeviceState.MOVING


@pytest.mark.parametrize(
    "bad",
    [(-1.0, *LIMITS[1:]), (*LIMITS[:5], -1.0, 5000, 25), (*LIMITS[:7], 0)],
    ids=["speed", "rate", "watchdog"],
)
def test_invalid_limits_are_ignored(firmware, bad):
    assert send_limits(firmware, *bad) == LIMITS


def test_shorter_watchdog_is_in_force(firmware):
    assert send_limits(firmware, *LIMITS[:7], 60)[-1] == 25
    assert send_limits(firmware, *LIMITS[:7], 11)[-1] == 11
    send_command(firmware, FrameKind.VELOCITY, 2, (1.0, 0.0, 0.0))
    firmware.tick(11_000)
    assert firmware.state is DeviceState.MOVING
    firmware.tick(11_001)
    assert firmware.state is DeviceState.TRIPPED


@pytest.mark.parametrize("speed", [1e30, -1e30, 4.001])
def test_clamped_speed_is_reported_until_a_stop(firmware, speed):
    sign = 1 if speed > 0 else -1
    # limit 4 rad/s; 300 rad/s^2 over two ticks allow 3 rad/s per command
    for number in range(2, 6):
        state = send_command(
            firmware, FrameKind.VELOCITY, number, (speed, 1.0, 0.0), 5000 * number
        ).state
        assert state is DeviceState.CLAMPED
        assert firmware.target == (
            pytest.approx(sign * min(4.0, 3.0 * (number - 1))),
            1.0,
            0.0,
        )
    assert (
        send_command(
            firmware, FrameKind.VELOCITY, 6, (sign * 4.0, 1.0, 0.0), 30_000
        ).state
        is DeviceState.CLAMPED
    )
    assert send_command(firmware, FrameKind.STOP, 7).state is DeviceState.IDLE
    assert (
        send_command(firmware, FrameKind.VELOCITY, 8, (1.0, 1.0, 0.0)).state
        is DeviceState.MOVING
    )


def test_velocity_change_over_a_lost_command_is_obeyed(firmware):
    send_command(firmware, FrameKind.VELOCITY, 2, (1.0, 0.0, 0.0), 0)
    # 3 rad/s in two ticks
    assert (
        send_command(firmware, FrameKind.VELOCITY, 4, (-2.0, 0.0, 0.0), 5000).state
        is DeviceState.MOVING
    )
    # 6 rad/s in 20 ms
    assert (
        send_command(firmware, FrameKind.VELOCITY, 8, (4.0, 0.0, 0.0), 25_000).state
        is DeviceState.MOVING
    )
    assert (
        send_command(firmware, FrameKind.VELOCITY, 9, (0.9, 0.0, 0.0), 30_000).state
        is DeviceState.CLAMPED
    )


def test_device_with_other_limits_is_refused(monkeypatch):
    wire = SerialWire("port", 0, watchdog=0.025)
    taken = lambda kind, values: LimitsAnswer(1, (*values[:-1], 20))  # noqa: E731
    monkeypatch.setattr(wire, "_exchange", taken)
    with pytest.raises(HardwareError, match="does not enforce the limits"):
        wire.set_limits(ARM)
    monkeypatch.setattr(wire, "_exchange", lambda kind, values: LimitsAnswer(1, values))
    wire.set_limits(ARM)
