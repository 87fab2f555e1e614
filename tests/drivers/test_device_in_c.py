"""The firmware in C agrees with the Python firmware.

Both get golden frames and fuzzed bytes; the real driver moves the C device over a
pseudo-terminal.
"""

import random
import shutil
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from rig import driver, movement

from stringcast.hardware.serial.firmware import Firmware
from stringcast.hardware.serial.protocol import (
    PROTOCOL_VERSION,
    Command,
    FrameKind,
    encode_command,
)
from stringcast.stages.execute.interfaces import HardwareError

FOLDER = Path(__file__).resolve().parents[2] / "hardware" / "serial" / "device"
POSE = (0.5, 0.25, -1.0)
STRICT = [
    "-std=c99",
    "-O1",
    "-Wall",
    "-Wextra",
    "-Wpedantic",
    "-Wconversion",
    "-Werror",
]
# with checked memory accesses, if the compiler supports it
SANITIZED = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]


@pytest.fixture(scope="module")
def build_device(tmp_path_factory):
    """Return a function that compiles the device with one of its two mains."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    folder = tmp_path_factory.mktemp("device")

    def build(main):
        program = folder / main
        sources = [str(FOLDER / f"{main}.c"), str(FOLDER / "stringcast.c"), "-lm"]
        if not program.exists():
            command = [compiler, *STRICT, "-o", program, *sources]
            result = subprocess.run(
                [*command, *SANITIZED], check=False, capture_output=True
            )
            if result.returncode:
                subprocess.run(command, check=True)
        return program

    return build


def answers_in_python(data):
    """Answer like pipe.c: byte by byte, with 1 ms after every delimiter."""
    firmware, out, now = Firmware(), b"", 0
    for byte in data:
        firmware.tick(now)
        out += firmware.receive(bytes([byte]), now, POSE)
        now += 1000 * (byte == 0)
    return out


def answers_in_c(program, data):
    return subprocess.run(
        [program], input=data, capture_output=True, check=True, timeout=20
    ).stdout


def golden():
    lines = (FOLDER / "golden.txt").read_text().splitlines()
    return (
        b"".join(bytes.fromhex(x[2:]) for x in lines if x.startswith(side))
        for side in "><"
    )


def test_python_firmware_answers_the_golden_conversation():
    said, answered = golden()
    assert encode_command(Command(FrameKind.VELOCITY, 65535, (1.5, -2.25, 0.0))) in said
    assert answers_in_python(said) == answered


def test_c_firmware_answers_the_golden_conversation(build_device):
    said, answered = golden()
    assert answers_in_c(build_device("pipe"), said) == answered


def fuzz(rng):
    """Make torn, flipped, overlong and random frames among valid commands.

    The valid commands reach all states.
    """
    sequence = 0
    stream = encode_command(Command(FrameKind.HELLO, 0, (PROTOCOL_VERSION,)))
    odd = [0.0, 1.5, -3.0, 0.1, -0.0, 1e30, -1e30, float("nan"), float("inf")]
    values = {
        FrameKind.VELOCITY: lambda: [
            rng.choice(odd[: rng.choice([1, 2, 5, 9])]) for _ in range(3)
        ]
    }
    usual = [2.0] * 3 + [300.0] * 3
    strange = [2.0, 1.5, 300.0, 0.0, 1e-3, -1.0, float("nan")]
    values[FrameKind.LIMITS] = lambda: [
        *rng.choice([usual, usual, [rng.choice(strange) for _ in range(6)]]),
        rng.choice([0, 5000]),
        rng.choice([0, 7, 400]),
    ]
    values[FrameKind.HELLO] = lambda: [
        rng.choice([PROTOCOL_VERSION, PROTOCOL_VERSION, 1])
    ]
    for _ in range(300):
        kind = rng.choice(
            [
                *[k for k in FrameKind if k < 0x80],
                FrameKind.VELOCITY,
                FrameKind.VELOCITY,
                FrameKind.HELLO,
                FrameKind.LIMITS,
            ]
        )
        sequence = (sequence + rng.choice([1, 1, 1, 0, -1, 40000])) % 2**16
        frame = bytearray(
            encode_command(Command(kind, sequence, tuple(values.get(kind, list)())))
        )
        harm = rng.randrange(8)
        if harm == 0:
            frame[rng.randrange(len(frame))] ^= 1 << rng.randrange(8)
        elif harm == 1:
            frame = frame[: rng.randrange(len(frame))]
        elif harm == 2:
            frame = (
                bytearray(rng.randbytes(rng.choice([1, 5, 63, 64, 65, 66, 300])))
                + b"\0"
            )
        elif harm == 3:
            frame += b"\0" * rng.choice([1, 5, 30])
        stream += bytes(frame)
    return stream


@pytest.mark.parametrize("seed", range(20))
def test_c_and_python_answer_fuzzed_bytes_equally(build_device, seed):
    stream = fuzz(random.Random(seed))
    answered = answers_in_python(stream)
    assert answers_in_c(build_device("pipe"), stream) == answered
    assert len(answered) > 1000  # the device did answer


@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        ("get(payload + count, CRC_BYTES) != crc32(payload, count)", "0"),
        ("fmin(fmax(wanted, -speed), speed)", "wanted"),
        ("fmin(fmax(slow, former - change), former + change)", "slow"),
        ("clear_limits(device);", ""),
        ("now_us - device->last_velocity_us > 1000u * watchdog", "0"),
        ("watchdog < device->watchdog_ms ? watchdog : device->watchdog_ms", "watchdog"),
    ],
)
def test_fuzzed_bytes_expose_a_wrong_firmware(tmp_path, right, wrong):
    """Without checksum, limit or watchdog, the answers differ."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    text = (FOLDER / "stringcast.c").read_text()
    assert text.count(right) == 1
    (tmp_path / "stringcast.c").write_text(text.replace(right, wrong))
    sources = [tmp_path / "stringcast.c", FOLDER / "pipe.c", f"-I{FOLDER}", "-lm"]
    subprocess.run(
        [compiler, "-std=c99", "-o", tmp_path / "pipe", *sources],
        check=True,
        capture_output=True,
    )
    streams = [fuzz(random.Random(seed)) for seed in range(20)]
    assert any(
        answers_in_c(tmp_path / "pipe", stream) != answers_in_python(stream)
        for stream in streams
    )


@pytest.fixture
def port(build_device):
    process = subprocess.Popen(
        [build_device("posix"), "250", "30"], stdout=subprocess.PIPE, text=True
    )
    yield process.stdout.readline().strip()
    process.kill()
    process.wait()
    process.stdout.close()


def test_real_driver_moves_the_c_device(port):
    with driver(port) as arm:
        performance = arm.perform(movement())
        np.testing.assert_allclose(arm.angles(), [0.5, -0.4, 0.6], atol=0.1)
    assert performance.ticks["t_acknowledged"].notna().mean() > 0.5


def hold_reason_of(wire, number, within=5.0):
    """Return the reason in the device's answer why it ignored a command."""
    end = time.monotonic() + within
    while time.monotonic() < end:
        for answer in wire.answers():
            if answer.number == number:
                return answer.hold_reason
        time.sleep(0.01)
    return None


def test_c_device_stops_without_its_host_until_a_new_greeting(
    port,
):
    with driver(port) as arm:
        arm.wire.send(np.array([0.5, 0.0, 0.0]))
        time.sleep(0.6)
        there = arm.angles()
        assert there[0] > 0
        number, _ = arm.wire.send(np.array([0.5, 0.0, 0.0]))
        assert "watchdog" in hold_reason_of(arm.wire, number)
        np.testing.assert_array_equal(arm.angles(), there)
    with driver(port) as arm:
        arm.wire.latch()
    with pytest.raises(HardwareError, match="latched"), driver(port):
        pass
